"""From pixels of faces and of everything else to a colour model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from tracker.conventions import Array
from tracker.learning.lessons import nodes_of
from tracker.segmentation.color_model import CLASSES, ColorModel
from tracker.segmentation.fit import FitOptions, Histograms, combine, pixel_histograms

GROUPS = 6
"""Groups of frames that count the same, whatever they show."""

ENOUGH = 150
"""Pixels of a colour, in all frames, from which it is learned."""

DISTRACTING = 0.2
"""Share of the background's draws that show what is taken for a face though it is none, if anything is: a
cross on the table fills a thousandth of the pictures."""

MOST = 200_000
"""Pixels of the background that are kept of a group."""


def learned_labels(pixels: Sequence[Mapping[int, Array]]) -> tuple[int, ...]:
    """Face colours of which there is enough to learn from."""
    counts = {label: sum(len(one.get(label, ())) for one in pixels) for label in range(1, CLASSES)}
    return tuple(label for label, count in counts.items() if count >= ENOUGH)


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
    labels = learned_labels(pixels)
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
