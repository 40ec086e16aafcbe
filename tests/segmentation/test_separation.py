"""How far apart colours are, and what is taken for what."""

from __future__ import annotations

import numpy as np
import pytest

from tracker.segmentation.confusion import confusion
from tracker.segmentation.hues import NAMED_HUES, hue_distance, hue_of
from tracker.segmentation.labelled import LabelledImage
from tracker.segmentation.separation import (
    LIGHT,
    better_set,
    distance,
    distance_to_light,
    distances,
    paints,
)

RED, GREEN, BLUE = (np.array(levels, dtype=float) for levels in ([20, 30, 160], [40, 150, 50], [150, 60, 20]))


def test_distance_is_symmetric_and_zero_to_itself():
    assert distance(RED, GREEN) == pytest.approx(distance(GREEN, RED))
    assert distance(RED, RED) == 0


def test_shade_alone_is_no_great_distance():
    assert distance(RED, 0.7 * RED) < 1.5 < distance(RED, GREEN)


def test_paler_colors_are_nearer_to_the_light_and_to_each_other():
    grey = np.full(3, 80.0)
    pale = [0.5 * color + 0.5 * grey for color in (RED, GREEN)]
    assert distance_to_light(pale[0]) < distance_to_light(RED)
    assert distance(*pale) < distance(RED, GREEN)
    assert distance_to_light(grey) == pytest.approx(0, abs=0.2)


def test_a_better_set_is_no_worse_and_keeps_the_names():
    means = {1: RED, 2: GREEN, 3: np.array([60.0, 50.0, 40.0]), 4: np.array([70.0, 65.0, 40.0])}
    better = better_set(means)
    assert min(distances(better).values()) > min(distances(means).values())
    for label, color in better.items():
        if (color != means[label]).any():
            assert hue_distance(hue_of(color[None]), NAMED_HUES[label]) < 25


def test_paints_are_those_of_neutral_light():
    rng = np.random.default_rng(4)
    labels = np.zeros((120, 120), np.uint8)
    labels[10:40, 10:40], labels[60:90, 10:40] = 1, 3
    scene = np.full((120, 120, 3), 110.0)
    scene[labels == 1], scene[labels == 3] = RED, BLUE
    scene += rng.normal(0, 1.5, scene.shape)
    tinted = np.clip(scene * [0.8, 1.0, 1.2], 0, 249)
    shown = [paints([LabelledImage("one", np.rint(one).astype(np.uint8), labels)]) for one in (scene, tinted)]
    for label in (1, 3):
        assert np.allclose(shown[0].means()[label], shown[1].means()[label], atol=6)
    assert np.allclose(shown[1].light, [0.8 / 1.2, 1 / 1.2, 1], atol=0.03)
    assert (LIGHT, 3) in distances(shown[0].means())


def test_confusion_counts_every_labelled_pixel_once_and_leaves_the_rim_out():
    truth = np.zeros((100, 100), np.uint8)
    truth[20:40, 20:40], truth[60:80, 60:80] = 2, 5
    found = truth.copy()
    found[20:30, 20:40] = 6
    found[41, 20:40] = 2  # beside the mask: not known
    found[0, :10] = 1
    counts = confusion([(found, truth), (truth, truth)])
    assert counts[2, 6] == 200
    assert counts[2].sum() == counts[5].sum() == 800
    assert counts[0, 1] == 10
    assert counts[0, 2] == 0
