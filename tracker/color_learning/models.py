"""Colour models to begin with, and those fitted to what frames teach."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from tracker.color_learning.fit import FitOptions, Histograms, combine, pixel_histograms
from tracker.color_learning.hues import NAMED_HUES, bgr_of_hue
from tracker.color_learning.lessons import Frames, judge, nodes_of
from tracker.conventions import Array, FloatArray
from tracker.objects.model import CuboidModel
from tracker.segmentation.color_model import CLASSES, ColorModel, color_model_names, load_colors

TRIED = 12
"""Frames on which the models compete."""

_OF_MANY_THINGS = "dice"
"""A model of one colour, which no cuboid has."""


def nearest(model: CuboidModel, footage: Sequence[Frames]) -> ColorModel:
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


GROUPS = 6
"""Groups of frames that count the same, whatever they show."""

ENOUGH = 150
"""Pixels of a colour, in all frames, from which it is learned."""

DISTRACTING = 0.2
"""Share of the background's draws that show what is taken for a face though it is none, if anything is: a
cross on the table fills a thousandth of the pictures."""

MOST = 200_000
"""Pixels of the background that are kept of a group."""


def learned(pixels: Sequence[Mapping[int, Array]]) -> dict[int, int]:
    """Pixels of each face colour of which there is enough to learn from."""
    counts = {label: sum(len(one.get(label, ())) for one in pixels) for label in range(1, CLASSES)}
    return {label: count for label, count in counts.items() if count >= ENOUGH}


def refit(
    pixels: Sequence[Mapping[int, Array]],
    taken: Array,
    before: Sequence[ColorModel],
    options: FitOptions,
    name: str,
) -> ColorModel:
    """A colour model fitted to frames' pixels (N, 3) in neutral light by label.

    Colours that the frames do not show stay as they were before.

    Args:
        pixels: of each frame; 0 is background.
        taken: (32³,) bool: colours that were taken for a face by mistake.
        before: models of which a little is kept, and all of what the frames do not show.
        options: of the fit.
        name: of the new model.
    """
    rng = np.random.default_rng([options.seed, *name.encode()])
    labels = learned(pixels)
    histograms: list[Histograms] = []
    for group in range(min(GROUPS, len(pixels))):
        chosen = pixels[group :: min(GROUPS, len(pixels))]
        parts: dict[int, Array] = {}
        for label in (*labels, 0):
            some = [one[label] for one in chosen if len(one.get(label, ()))]
            if some:
                parts[label] = np.concatenate(some)
        if 0 in parts:
            parts[0] = _with_distracting(parts[0], taken, rng)
        histograms.append(pixel_histograms(parts, options, rng))
    return combine(histograms, [_remembered(one) for one in before], options, name=name)


def _with_distracting(background: Array, taken: Array, rng: np.random.Generator) -> Array:
    """Background in which DISTRACTING of all pixels have colours that are taken for a face, if some have."""
    distracting = background[taken[nodes_of(background)]]
    if len(background) > MOST:
        background = background[rng.integers(len(background), size=MOST)]
    if not len(distracting):
        return background
    more = round(DISTRACTING / (1.0 - DISTRACTING) * len(background))
    return np.concatenate([background, distracting[rng.integers(len(distracting), size=more)]])


def _remembered(model: ColorModel) -> Histograms:
    """What a model knows of its face colours, as densities over colours that are all as likely."""
    posterior = np.exp(model.log_posterior)
    posterior /= posterior.sum(axis=0)
    return {label: posterior[label] / posterior[label].sum() for label in range(1, CLASSES)}
