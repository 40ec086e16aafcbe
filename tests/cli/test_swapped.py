"""Pictures of cameras that run, given to the wrong ones."""

from __future__ import annotations

from dataclasses import replace

import pytest

import tracker
from tests.helpers.filmed import RIG, shots
from tests.helpers.moments import moment
from tracker.cli import swapped
from tracker.cli.swapped import Lookout

FOLLOWER = tracker.ObjectTracker(tracker.load_object("cube_v2"), RIG)


@pytest.fixture(autouse=True)
def at_once(monkeypatch):
    monkeypatch.setattr(swapped, "FIRST_LOOK", 0.0)


@pytest.fixture(scope="module")
def images():
    return shots("cube_v2", 1, seed=702)[0].images


def test_cameras_in_the_wrong_order_are_told_once_two_looks_agree(images):
    one = moment(0, (images[1], images[0], images[2]))
    lookout = Lookout(lambda: FOLLOWER, RIG.names)
    said = [lookout.look(one) for _ in range(3)]
    assert said == [None, f"the images of {RIG.names[0]} and {RIG.names[1]} look swapped", None]


def test_once_the_object_is_surely_found_nobody_looks_any_more(images):
    found = FOLLOWER.detect(images)
    assert found.object_pose.confidence > 0.9
    lookout = Lookout(lambda: pytest.fail("it looks"), RIG.names)
    assert lookout.look(None) is None
    assert lookout.look(replace(moment(0, tuple(images)), observation=found)) is None
    assert lookout.look(moment(1, (images[1], images[0], images[2]))) is None
