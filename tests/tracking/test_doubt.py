"""Which cameras are believed over time, and what is said of each."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tests.helpers.fits import made_fit, with_cameras
from tests.helpers.pushed_cube import DT, new
from tracker import CameraUse
from tracker.tracking.cameras import CameraMemory
from tracker.tracking.doubt import DOUBTED, MOST_DOUBT, after, heard, held_back

IMAGES = [np.zeros((8, 8, 3), np.uint8)] * 3
USED = [CameraUse.USED] * 3
NEW = (CameraMemory(),) * 3


def fit_with(c, **fields):
    return with_cameras(made_fit(), c, **fields)


def astray(c):
    """Camera c shows the object elsewhere."""
    return fit_with(c, agree=0, missing=410, elsewhere=350, usable=0.0, inliers=0.0, squares=0.0)


def hidden(c):
    """Something hides the object from camera c."""
    return fit_with(c, agree=0, missing=410, usable=0.0, inliers=0.0, squares=0.0)


def after_pictures(fit, count, memories=NEW):
    for _ in range(count):
        memories = heard(memories, fit)
    return memories


@pytest.mark.parametrize("c", range(3))
def test_a_camera_that_goes_astray_is_held_back_and_comes_back_when_it_agrees(c):
    memories = after_pictures(astray(c), DOUBTED - 1)
    assert held_back(memories, IMAGES) == []
    memories = after_pictures(astray(c), 100, memories)
    assert held_back(memories, IMAGES) == [c]
    assert memories[c].doubt == MOST_DOUBT
    assert held_back(after_pictures(made_fit(), 2, memories), IMAGES) == []


def test_a_hidden_object_raises_no_doubt_about_the_camera():
    assert held_back(after_pictures(hidden(1), 100), IMAGES) == []


def test_an_unsure_pose_raises_no_doubt_about_a_camera():
    unsure = dataclasses.replace(made_fit(sure=False), cameras=astray(1).cameras, lead=-3.0)
    assert held_back(after_pictures(unsure, 100), IMAGES) == []


def test_enough_cameras_are_always_left():
    memories = after_pictures(astray(1), 100)
    assert held_back(memories, [IMAGES[0], IMAGES[1], None]) == []
    assert held_back(memories, [IMAGES[0], None, IMAGES[2]]) == []


def test_what_is_said_of_a_picture_goes_before_what_the_pose_says():
    uses = [CameraUse.BLACK, CameraUse.USED, CameraUse.FROZEN]
    assert after(uses, astray(0)) == tuple(uses)
    assert after(USED, astray(0)) == (CameraUse.CONTRADICTING, CameraUse.USED, CameraUse.USED)
    assert after(USED, hidden(2)) == tuple(USED)
    left_out = dataclasses.replace(hidden(2), left_out=(2,))
    assert after(USED, left_out)[2] is CameraUse.CONTRADICTING
    assert after(USED, hidden(2), unused=[2])[2] is CameraUse.CONTRADICTING


def test_each_camera_of_an_observation_has_its_word(rig, film):
    black = np.zeros_like(film[0][0])
    mirrored = np.ascontiguousarray(film[0][2][:, ::-1])
    assert new(rig).detect(film[0]).cameras == tuple(USED)
    assert new(rig).detect([film[0][0], None, film[0][2]]).cameras[1] is CameraUse.NO_IMAGE
    assert new(rig).detect([black, *film[0][1:]]).cameras == (CameraUse.BLACK, *USED[1:])
    assert new(rig).detect([*film[0][:2], mirrored]).cameras == (*USED[:2], CameraUse.CONTRADICTING)
    nothing = new(rig).detect([black] * 3)
    assert nothing.object_pose is None
    assert nothing.cameras == (CameraUse.BLACK,) * 3


def test_a_black_picture_counts_as_none(rig, film):
    black = np.zeros_like(film[0][0])
    one = new(rig).detect([black, *film[0][1:]]).object_pose
    other = new(rig).detect([None, *film[0][1:]]).object_pose
    assert np.array_equal(one.world_from_object, other.world_from_object)


def test_a_camera_that_is_mirrored_for_a_while_costs_nothing_and_is_used_again(rig, film):
    tracker, said = new(rig), []
    for k, images in enumerate(film):
        if 2 <= k < 9:
            images = [images[0], np.ascontiguousarray(images[1][:, ::-1]), images[2]]
        answer = tracker.update(images, DT * k)
        assert answer.object_pose is not None
        said.append(answer.cameras[1].value)
    assert set(said[3:9]) == {"contradicting"}
    assert said[:2] == ["used"] * 2
    assert said[-1] == "used"
