"""The colours to begin with."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from tracker.conventions import FloatArray
from tracker.learning.footage import Footage
from tracker.learning.judge import judge
from tracker.objects.model import CuboidModel
from tracker.segmentation.color_model import CLASSES, ColorModel, color_model_names, load_colors
from tracker.segmentation.fit import FitOptions, combine, pixel_histograms
from tracker.segmentation.hues import NAMED_HUES, bgr_of_hue

TRIED = 12
"""Frames on which the models compete."""

_OF_MANY_THINGS = "dice"
"""A model of one colour, which no cuboid has."""


def nearest(model: CuboidModel, footage: Sequence[Footage]) -> ColorModel:
    """The shipped colour model that explains most of some of the frames that teach."""
    step = max(1, sum(len(one.learned) for one in footage) // TRIED)
    few = [dataclasses.replace(one, learned=(), held_out=one.learned[::step]) for one in footage]
    names = [name for name in color_model_names() if name != _OF_MANY_THINGS]
    models = [dataclasses.replace(load_colors(name), normalise=True) for name in names]
    return max(models, key=lambda colors: judge(model, few, colors).explained)


DRAWN = 40_000
"""Pixels that stand for each colour of which only the name is known."""

HUE_SPREAD = 12.0
"""Standard deviation of a paint's hue around that of its name [degrees]."""

LEVELS, SATURATIONS = (25.0, 255.0), (0.4, 1.0)
"""Of the brightest channel of a face's pixel, and of its saturation: the rest of its largest channel."""

GREY = 0.25
"""Saturation up to which anything may be grey."""


def from_names(seed: int) -> ColorModel:
    """A colour model that knows of the faces the names of their colours alone.

    Pixels are drawn around each name's hue, of any brightness and of all but pale saturations; background
    is what is nearly grey.
    """
    rng = np.random.default_rng([seed, 7])
    pixels = {0: _of_hue(rng.uniform(0, 360, 4 * DRAWN), rng, (0.0, GREY), (0.0, 255.0))}
    for label in range(1, CLASSES):
        hues = NAMED_HUES[label] + HUE_SPREAD * rng.standard_normal(DRAWN)
        pixels[label] = _of_hue(hues, rng, SATURATIONS, LEVELS)
    options = FitOptions(seed=seed)
    return combine([pixel_histograms(pixels, options, rng)], (), options, name="names")


def _of_hue(
    hues: FloatArray,
    rng: np.random.Generator,
    saturations: tuple[float, float],
    levels: tuple[float, float],
) -> FloatArray:
    """Pixels (N, 3) BGR of hues (N,) [degrees], even draws of saturation and of the brightest channel."""
    return bgr_of_hue(hues, rng.uniform(*saturations, len(hues)), rng.uniform(*levels, len(hues)))
