"""Faces that are mistaken for each other are told by their hues."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import tracker
from tracker.segmentation.color_model import ColorModel
from tracker.segmentation.hues import NAMED_HUES, hue_distance, hue_of, hues_of_model, misnamed

CUBOIDS = ("cube_v1", "cube_v2", "cube_v3", "cuboid_2x2x8_v2", "simulation")


def test_the_hue_does_not_depend_on_brightness():
    pixels = np.random.default_rng(1).uniform(20, 120, (50, 3)) * [0.3, 1.0, 0.5]
    assert hue_of(pixels) == pytest.approx(hue_of(2 * pixels))


@pytest.mark.parametrize(
    ("bgr", "hue"),
    [((0, 0, 9), 0), ((0, 9, 9), 60), ((0, 9, 0), 120), ((9, 9, 0), 180), ((9, 0, 0), 240), ((9, 0, 9), 300)],
)
def test_pure_colors_have_their_hues(bgr, hue):
    assert hue_distance(hue_of(np.array([bgr, bgr])), hue) == pytest.approx(0, abs=1e-9)


def test_grey_has_no_hue_and_suits_no_name():
    assert np.isnan(hue_of(np.full((4, 3), 80)))
    assert misnamed({3: float("nan")}) == {3: 0}


def test_hues_of_the_names_are_in_order():
    assert misnamed({label: NAMED_HUES[label] for label in range(1, 7)}) == {}


@pytest.mark.parametrize("name", CUBOIDS)
def test_shipped_models_have_the_hues_of_their_names(name):
    assert misnamed(hues_of_model(tracker.load_colors(name))) == {}


@pytest.mark.parametrize("name", CUBOIDS)
def test_every_exchange_of_two_or_three_faces_is_noticed(name):
    hues = hues_of_model(tracker.load_colors(name))
    for a, b in itertools.combinations(hues, 2):
        assert set(misnamed(hues | {a: hues[b], b: hues[a]})) >= {a, b}
    for a, b, c in itertools.permutations(hues, 3):
        assert set(misnamed(hues | {a: hues[b], b: hues[c], c: hues[a]})) >= {a, b, c}


def test_exchanged_tables_are_exchanged_hues():
    model = tracker.load_colors("cube_v2")
    log_posterior = model.log_posterior.copy()
    log_posterior[[1, 2]] = log_posterior[[2, 1]]
    hues, exchanged = hues_of_model(model), hues_of_model(ColorModel("exchanged", log_posterior))
    assert (exchanged[1], exchanged[2]) == (hues[2], hues[1])
