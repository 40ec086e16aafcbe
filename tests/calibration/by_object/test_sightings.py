"""Which frames of a film count as rests, and which as different poses."""

from __future__ import annotations

import numpy as np
import pytest

from tests.helpers import random_rotations
from tracker.calibration.by_object.sightings import Sighting, different, resting
from tracker.errors import CalibrationError
from tracker.geometry import so3

STILL = np.zeros(6)


def sighting(number, *, at=(0.0, 0.0), turn=(0.0, 0.0, 0.3), velocity=STILL, begins=False):
    return Sighting(number, np.array([*at, 0.0325]), so3.exp(turn), velocity, 0.0, begins)


@pytest.mark.parametrize(
    ("film", "found"),
    [
        ([sighting(k, begins=k == 0) for k in range(30)], [15]),
        ([sighting(k, at=(0.05 * (k // 5), 0.0)) for k in range(15)], [2, 7, 12]),
        ([sighting(k, velocity=np.array([0.02, 0, 0, 0, 0, 0])) for k in range(10)], []),
        ([sighting(k, velocity=np.array([0, 0, 0, 0, 0.2, 0])) for k in range(10)], []),
        ([sighting(k, turn=(np.radians(20), 0.0, 0.0)) for k in range(10)], []),
        ([sighting(k) for k in range(2)], []),
        ([sighting(k) for k in (0, 2, 4, 6)], []),
        ([sighting(k, begins=k in (0, 2)) for k in range(4)], []),
        ([sighting(k, velocity=None, begins=True) for k in range(4)], [0, 1, 2, 3]),
    ],
    ids=["one", "places", "moves", "turns", "on an edge", "too short", "gaps", "two films", "stills"],
)
def test_a_rest_of_some_frames_in_a_row_counts_once(film, found):
    assert [one.number for one in resting(film)] == found


def anywhere(count, rng, *, speed=0.0, skew=0.0):
    places = rng.uniform([-0.1, -0.1, 0.03], [0.1, 0.1, 0.1], (count, 3))
    velocity = np.array([speed, 0, 0, 0, 0, 0])
    return [
        Sighting(k, place, rotation, velocity, skew, k == 0)
        for k, (place, rotation) in enumerate(zip(places, random_rotations(rng, count), strict=True))
    ]


def test_poses_that_were_seen_are_not_taken_again_and_too_few_refused(rng):
    once = anywhere(30, rng)
    assert len(different("cube", [once, once], 100)) == len(different("cube", [once], 100)) == 30
    with pytest.raises(CalibrationError, match="found 10 of the 18 different poses or more in which cube"):
        different("cube", [anywhere(10, rng)], 100)


def test_no_more_are_taken_than_requested_and_they_are_spread_evenly(rng):
    numbers = [one.number for _, one in different("cube", [anywhere(90, rng)], 30)]
    assert len(numbers) == 30
    assert numbers[0] == 0
    assert numbers[-1] == 89
    assert max(np.diff(numbers)) <= 4


def test_pictures_that_cameras_took_one_after_the_other_do_not_count_while_it_moves(rng):
    still, moving = anywhere(20, rng, skew=0.01), anywhere(20, rng, skew=0.01, speed=0.3)
    assert {k for k, _ in different("cube", [still, moving], 100)} == {0}
    with pytest.raises(CalibrationError, match="in 20 more it moved between the cameras' pictures"):
        different("cube", [moving], 100)
