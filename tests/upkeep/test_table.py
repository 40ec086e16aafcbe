from __future__ import annotations

import numpy as np
import pytest

import tracker
from tests.helpers.filmed import RIG
from tests.helpers.resting_cube import rests as rests_of
from tracker.calibration.table_plane import moved
from tracker.errors import CalibrationError
from tracker.geometry import so3
from tracker.upkeep.footage import Stills
from tracker.upkeep.table import find_table

MODEL, COLORS = tracker.load_object("cube_v2"), tracker.load_colors("cube_v2")


@pytest.fixture(scope="module")
def rests():
    return rests_of()


def floating(height=0.005, degrees=1.0):
    """(4, 4) to the true world from one that floats."""
    out = np.eye(4)
    out[:3, :3] = so3.exp(np.radians([degrees, 0.0, 0.0]))
    out[2, 3] = height
    return out


def stills(rests):
    return Stills([still.images for still in rests])


@pytest.mark.parametrize("height", [0.005, -0.006])
def test_a_floating_world_comes_down_to_the_table(rests, height):
    found = find_table(MODEL, [stills(rests)], moved(RIG, floating(height)), COLORS)
    assert len(found.plane.used) == len(rests)
    for before, after in zip(RIG, found.rig, strict=True):
        new_from_true = np.linalg.inv(after.camera_from_world) @ before.camera_from_world
        assert abs(new_from_true[2, 3]) < 0.1e-3
        assert np.degrees(np.linalg.norm(so3.log(new_from_true[:3, :3])[:2])) < 0.05
    assert found.rig.arena.table == 0.0
    assert found.rig.arena.table_std[0] < 0.5e-3


def test_several_films_and_stills_count_together(rests):
    parts = [stills(rests[:2]), stills(rests[2:])]
    one = find_table(MODEL, parts, RIG, COLORS)
    other = find_table(MODEL, [stills(rests)], RIG, COLORS)
    assert one.plane.height == other.plane.height


@pytest.mark.parametrize(
    ("seen", "rig", "said"),
    [
        (
            lambda images: images,
            tracker.CameraRig((RIG[0],)),
            "found camera60 alone, expected two cameras or more",
        ),
        (lambda images: [[one[0], None, None] for one in images], RIG, "one camera"),
        (lambda images: images[:1] * 6, RIG, "lay it also near"),
        (lambda images: np.full_like(images[:2], 110), RIG, "no picture in which cube_v2 is surely seen"),
    ],
    ids=["one camera", "seen by one camera", "one place", "no object"],
)
def test_what_shows_no_table_is_refused_with_the_reason(seen, rig, said, rests):
    with pytest.raises(CalibrationError, match=said):
        find_table(MODEL, [Stills(list(seen([still.images for still in rests])))], rig, COLORS)
