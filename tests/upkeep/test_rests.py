from __future__ import annotations

import numpy as np
import pytest

from tracker.geometry import so3
from tracker.upkeep.rests import resting
from tracker.upkeep.sightings import Sighting

STILL = np.zeros(6)


def sighting(number, *, at=(0.0, 0.0), turn=(0.0, 0.0, 0.3), velocity=STILL, begins=False):
    return Sighting(number, np.array([*at, 0.0325]), so3.exp(turn), velocity, 0.0, begins)


def numbers(film):
    return [one.number for one in resting(film)]


def test_a_long_rest_counts_once():
    assert numbers([sighting(k, begins=k == 0) for k in range(30)]) == [15]


def test_each_place_counts():
    film = [sighting(k, at=(0.05 * (k // 5), 0.0)) for k in range(15)]
    assert len(numbers(film)) == 3


@pytest.mark.parametrize("velocity", [(0.02, 0, 0, 0, 0, 0), (0, 0, 0, 0, 0.2, 0)])
def test_what_moves_does_not_rest(velocity):
    assert numbers([sighting(k, velocity=np.array(velocity)) for k in range(10)]) == []


def test_what_stands_on_an_edge_does_not_rest():
    assert numbers([sighting(k, turn=(np.radians(20), 0.0, 0.0)) for k in range(10)]) == []


def test_a_short_stop_and_frames_that_do_not_follow_each_other_are_no_rest():
    assert numbers([sighting(k) for k in range(2)]) == []
    assert numbers([sighting(k) for k in (0, 2, 4, 6)]) == []


def test_every_still_that_shows_it_level_counts():
    stills = [sighting(k, velocity=None, begins=True) for k in range(4)]
    assert numbers(stills) == [0, 1, 2, 3]


def test_films_are_not_joined():
    film = [sighting(k, begins=k in (0, 2)) for k in range(4)]
    assert numbers(film) == []
