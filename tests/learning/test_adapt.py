"""Colours learned without labels, against the true labels of other pictures."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import tracker
from tests.helpers.filmed import footage_of, overlap, shots
from tracker.errors import ColorModelError
from tracker.learning.adapt import adapt
from tracker.learning.judge import judge
from tracker.learning.refit import refit
from tracker.learning.start import from_names, nearest
from tracker.segmentation.fit import FitOptions

MODEL = tracker.load_object("cube_v2")
OPTIONS = FitOptions(draws=5000)


@pytest.fixture(scope="module")
def other_film():
    return shots("cube_v2", 3, seed=512)


@pytest.fixture(scope="module")
def learned(film):
    start = tracker.load_colors("simulation")
    return adapt(MODEL, [footage_of(film)], start, OPTIONS, name="mine", rounds=3)


def test_colors_of_renderings_become_those_of_the_pictures(learned, other_film):
    start = dataclasses.replace(tracker.load_colors("simulation"), normalise=True)
    shipped = overlap(other_film, tracker.load_colors("cube_v2"))
    before, after = overlap(other_film, start), overlap(other_film, learned.colors)
    assert learned.after.explained > learned.before.explained
    assert after - before > 0.8 * (shipped - before)


def test_the_same_frames_give_the_same_colors(film, learned):
    start = tracker.load_colors("simulation")
    again = adapt(MODEL, [footage_of(film)], start, OPTIONS, name="mine", rounds=3)
    assert (again.colors.log_posterior == learned.colors.log_posterior).all()


def test_another_object_is_refused(film):
    cuboid = tracker.load_object("cuboid_2x2x8_v2")
    with pytest.raises(ColorModelError, match="refused"):
        adapt(cuboid, [footage_of(film)], tracker.load_colors("cube_v2"), OPTIONS, name="mine", rounds=2)


def test_the_nearest_shipped_model_explains_most(film):
    footage = footage_of(film)
    judged = [dataclasses.replace(footage, held_out=footage.learned)]
    best = judge(MODEL, judged, nearest(MODEL, [footage])).explained
    for name in ("cube_v1", "cube_v2", "simulation"):
        colors = dataclasses.replace(tracker.load_colors(name), normalise=True)
        assert best >= judge(MODEL, judged, colors).explained


def test_colors_that_are_not_shown_stay_as_they_were():
    rng = np.random.default_rng(3)
    before = tracker.load_colors("cube_v2")
    pixels = [
        {0: rng.integers(90, 130, (4000, 3)), 1: rng.integers((10, 20, 150), (30, 40, 170), (400, 3))}
        for _ in range(6)
    ]
    model = refit(pixels, np.zeros(32**3, dtype=bool), [before], OPTIONS, "mine")
    old = np.argmax(before.log_posterior, axis=0)
    new = np.argmax(model.log_posterior, axis=0)
    for label in range(2, 7):
        sure = (old == label) & (before.log_posterior[0] < -2)
        assert (new[sure] == label).mean() > 0.85


def test_names_alone_tell_pure_colors():
    labels = from_names(0).label_table.reshape(64, 64, 64)  # red, green, blue
    for label, (blue, green, red) in enumerate(
        [(0, 0, 1), (0, 1, 0), (1, 0, 0), (1, 1, 0), (1, 0, 1), (0, 1, 1)], start=1
    ):
        assert labels[50 * red, 50 * green, 50 * blue] == label
