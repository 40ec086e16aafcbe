"""Every shipped table reads its colours in whatever light."""

from __future__ import annotations

import numpy as np
import pytest

import tracker
from scripts.fit_shipped_colors import SIMULATION_RGB
from tests.segmentation.test_light_gains import exposed
from tracker.objects.labels import COLOR_NAMES
from tracker.segmentation.color_model import color_model_names


@pytest.mark.parametrize("name", color_model_names())
def test_every_shipped_table_reads_normalised_pictures(name):
    assert tracker.load_colors(name).normalise


def drawn_scene(size: int = 240) -> tuple[np.ndarray, np.ndarray]:
    """Greys of different brightness and a patch of each of the simulation's colours (float64); its labels."""
    image = np.linspace(70, 150, size)[:, None, None] * np.ones((size, size, 3))
    labels = np.zeros((size, size), np.uint8)
    for place, (name, rgb) in enumerate(SIMULATION_RGB.items()):
        patch = slice(100, 130), slice(10 + 38 * place, 40 + 38 * place)
        image[patch] = 0.6 * np.array(rgb[::-1])
        labels[patch] = COLOR_NAMES.index(name)
    return image, labels


def test_the_simulations_colours_keep_their_labels_in_other_light():
    rng = np.random.default_rng(3)
    image, truth = drawn_scene()
    colors = tracker.load_colors("simulation")
    for _ in range(20):
        gains = rng.uniform(0.6, 1.5, 3)
        found = tracker.segment(exposed(image, gains), colors)
        assert np.mean(found[truth > 0] == truth[truth > 0]) > 0.97
        assert np.mean(found[truth == 0] > 0) < 0.01
