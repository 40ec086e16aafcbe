from __future__ import annotations

import numpy as np
import pytest

from tests.helpers import random_rotations
from tracker.errors import CalibrationError
from tracker.upkeep.sightings import Sighting
from tracker.upkeep.variety import different


def sightings(count, rng, *, speed=0.0, skew=0.0):
    places = rng.uniform([-0.1, -0.1, 0.03], [0.1, 0.1, 0.1], (count, 3))
    velocity = np.array([speed, 0, 0, 0, 0, 0])
    return [
        Sighting(k, place, rotation, velocity, skew, k == 0)
        for k, (place, rotation) in enumerate(zip(places, random_rotations(rng, count), strict=True))
    ]


def test_poses_that_were_seen_are_not_taken_again(rng):
    once = sightings(30, rng)
    assert len(different("cube", [once, once], 100)) == len(different("cube", [once], 100)) == 30


def test_no_more_are_taken_than_wanted_and_they_are_spread_evenly(rng):
    numbers = [one.number for _, one in different("cube", [sightings(90, rng)], 30)]
    assert len(numbers) == 30
    assert numbers[0] == 0
    assert numbers[-1] == 89
    assert max(np.diff(numbers)) <= 4


def test_pictures_that_cameras_took_one_after_the_other_do_not_count_while_it_moves(rng):
    still, moving = sightings(20, rng, skew=0.01), sightings(20, rng, skew=0.01, speed=0.3)
    assert {k for k, _ in different("cube", [still, moving], 100)} == {0}
    with pytest.raises(CalibrationError, match="in 20 more it moved between the cameras' pictures"):
        different("cube", [moving], 100)


def test_too_few_are_refused(rng):
    with pytest.raises(CalibrationError, match="found 10 of the 18 different poses or more in which cube"):
        different("cube", [sightings(10, rng)], 100)
