"""What the names of the face colours promise: their hues, by which mistaken faces are told.

Cameras show paints, not pure colours: on labelled pictures of the platform's objects in neutral light red
is found at 8 to 23°, yellow at 46 to 56°, green at 81 to 120°, cyan at 172 to 183°, blue at 208 to 215°,
magenta at 290 to 347°.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.optimize import linear_sum_assignment

from tracker.conventions import Array, FloatArray
from tracker.segmentation.color_model import CLASSES, NODES, ColorModel

NAMED_HUES: FloatArray = np.array([np.nan, 12.0, 100.0, 212.0, 178.0, 312.0, 52.0])
"""(7,) hue that each label's name promises [degrees]; label 0 has none."""

MAX_OFF = 45.0
"""Farthest hue from that of its name [degrees]."""

MAX_GAIN = 30.0
"""Names dealt out anew among the faces that are seen may bring their hues so much nearer in all [degrees]."""


def hue_of(pixels: Array) -> float:
    """Hue [degrees] of the median of pixels (N, 3) BGR in neutral light; NaN where that is grey."""
    blue, green, red = np.median(np.asarray(pixels, dtype=np.float64), axis=0)
    # The hexagon's two axes: hues go by the angle, whatever brightness and saturation.
    along, across = red - 0.5 * (green + blue), np.sqrt(0.75) * (green - blue)
    if np.hypot(along, across) < 1.0:
        return float("nan")
    return float(np.degrees(np.arctan2(across, along)) % 360.0)


def hues_of_model(colors: ColorModel) -> dict[int, float]:
    """Hue [degrees] of what a colour model takes for each face colour, as far as it knows it."""
    best = np.argmax(colors.log_posterior, axis=0)
    result = {}
    for label in range(1, CLASSES):
        nodes = np.argwhere(best == label)
        if len(nodes):
            result[label] = hue_of(255.0 * (nodes / (NODES - 1)) ** 2)
    return result


def bgr_of_hue(hues: FloatArray, saturations: FloatArray, levels: FloatArray) -> FloatArray:
    """Pixels (N, 3) BGR of hues [degrees], saturations up to 1 and levels of the brightest channel (N,)."""
    # A channel lacks all that the saturation says but within 60° of its own hue, linearly less up to 120°.
    sector = (hues[:, None] / 60.0 + np.array([1.0, 3.0, 5.0])) % 6.0  # blue, green, red
    lack = np.clip(np.minimum(sector, 4.0 - sector), 0.0, 1.0)
    return np.asarray(levels[:, None] * (1.0 - saturations[:, None] * lack), dtype=np.float64)


def hue_distance(a: Array | float, b: Array | float) -> FloatArray:
    """Smallest turn between hues [degrees]."""
    turn = np.abs(np.asarray(a, dtype=np.float64) - b) % 360.0
    return np.asarray(np.minimum(turn, 360.0 - turn), dtype=np.float64)


def misnamed(hues: Mapping[int, float]) -> dict[int, int]:
    """Labels whose hue is not what their name promises, and the label whose name would suit.

    A hue is too far from its name, or the names would suit much better if they were dealt out otherwise
    among the labels that are given.

    Args:
        hues: hue of what has each label [degrees]; NaN is no colour at all and suits no name.
    """
    labels = [label for label, hue in hues.items() if np.isfinite(hue)]
    wrong = {label: 0 for label, hue in hues.items() if not np.isfinite(hue)}
    if not labels:
        return wrong
    found = np.array([hues[label] for label in labels])
    distance = hue_distance(found[:, None], NAMED_HUES[None, labels])
    own = np.diag(distance)
    _, dealt = linear_sum_assignment(distance)
    if own.sum() - distance[np.arange(len(labels)), dealt].sum() > MAX_GAIN:
        wrong |= {labels[k]: labels[j] for k, j in enumerate(dealt) if k != j}
    for label, hue, off in zip(labels, found, own, strict=True):
        if off > MAX_OFF and label not in wrong:
            wrong[label] = 1 + int(np.argmin(hue_distance(hue, NAMED_HUES[1:])))
    return wrong
