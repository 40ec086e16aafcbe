"""The colours of faces: the hues that their names promise, and how far they are from each other.

Cameras show paints, not pure colours: on labelled pictures of the platform's objects in neutral light red
is found at 8 to 23°, yellow at 46 to 56°, green at 81 to 120°, cyan at 172 to 183°, blue at 208 to 215°,
magenta at 290 to 347°.

How far apart two colours are is how far light, shade and camera may move one towards the other: a colour is
a point of log blue, green, red in neutral light, and distances are counted in standard deviations of that.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from tracker.color_learning.labelled import LabelledImage
from tracker.conventions import Array, FloatArray
from tracker.segmentation.color_model import CLASSES, NODES, ColorModel
from tracker.segmentation.light import apply_gains, evened, find_light

NAMED_HUES: FloatArray = np.array([np.nan, 12.0, 100.0, 212.0, 178.0, 312.0, 52.0])
"""(7,) hue that each label's name promises [degrees]; label 0 has none."""

MAX_OFF = 45.0
"""Farthest hue from that of its name [degrees]."""

MAX_GAIN = 30.0
"""Other names for the faces that are seen may bring their hues at most so much nearer in all [degrees]."""

BRIGHTNESS, CHANNEL, LEVEL = 0.35, 0.07, 6.0
"""Standard deviations of the log of a face's brightness (light and shade), of the log of each channel, and of
what is added to a level by haze and noise."""

NEAR = 4.0
"""Distance [standard deviations] below which two colours are taken for each other now and then."""

MOST = 4000
"""Pixels of each colour that are kept."""

LIGHT = 0
"""Stands for the colour of the light, which is that of everything grey, where a label is expected."""

_HUES, _SATURATIONS, _LEVELS = np.arange(-20.0, 21.0, 10.0), (0.6, 0.75, 0.9), (70.0, 110.0, 160.0, 210.0)
_SWEEPS = 4


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
    nodes = {label: np.argwhere(best == label) for label in range(1, CLASSES)}
    return {label: hue_of(255.0 * (its / (NODES - 1)) ** 2) for label, its in nodes.items() if len(its)}


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


@dataclass(frozen=True, eq=False)
class Paints:
    """What labelled images show of the faces' colours."""

    pixels: Mapping[int, Array]
    """(N, 3) levels BGR in neutral light, by label."""
    light: FloatArray
    """(3,) BGR, the largest 1: what the images' greys look like as the camera gives them."""

    def means(self) -> dict[int, FloatArray]:
        """(3,) median levels of each colour."""
        return {label: np.median(some, axis=0) for label, some in self.pixels.items()}


def paints(images: Sequence[LabelledImage]) -> Paints:
    """The colours of labelled images, each in the light that its greys tell."""
    found: dict[int, list[Array]] = {}
    lights = []
    for one in images:
        light = find_light(one.image)
        neutral = apply_gains(evened(one.image, light), light.gains)
        lights.append(-np.log(light.gains))
        for label in np.unique(one.labels[one.labels > 0]):
            found.setdefault(int(label), []).append(neutral[one.labels == label])
    raw = np.exp(np.median(lights, axis=0))
    joined = {label: np.concatenate(some) for label, some in sorted(found.items())}
    return Paints({label: some[:: len(some) // MOST + 1] for label, some in joined.items()}, raw / raw.max())


def distance(a: FloatArray, b: FloatArray) -> FloatArray:
    """Distances (...) of colours (..., 3) [levels], in standard deviations of what light and camera do."""
    difference = np.log(a + LEVEL) - np.log(b + LEVEL)
    own = CHANNEL**2 + 0.5 * ((LEVEL / (a + LEVEL)) ** 2 + (LEVEL / (b + LEVEL)) ** 2)
    covariance = BRIGHTNESS**2 + own[..., None] * np.eye(3)
    scaled = np.linalg.solve(covariance, difference[..., None])[..., 0]
    return np.asarray(np.sqrt((difference * scaled).sum(axis=-1)))


def distance_to_light(colors: FloatArray) -> FloatArray:
    """Distances (...) of colours (..., 3) [levels] to the nearest grey of any brightness."""
    return np.asarray(distance(colors[..., None, :], np.geomspace(8.0, 240.0, 40)[:, None]).min(axis=-1))


def distances(means: Mapping[int, FloatArray]) -> dict[tuple[int, int], float]:
    """Distances of all pairs of colours, and of each to the light as (LIGHT, label)."""
    labels = sorted(means)
    pairs = {(a, b): float(distance(means[a], means[b])) for a in labels for b in labels if a < b}
    return {(LIGHT, label): float(distance_to_light(means[label])) for label in labels} | pairs


def better_set(means: Mapping[int, FloatArray]) -> dict[int, FloatArray]:
    """Colours (3,) [levels] with the same names whose smallest distance is as large as can be.

    One colour after the other is moved to where it is farthest from its nearest neighbour, among paints
    within 20° of its name's hue; those that nothing is gained for stay.
    """
    chosen = {label: np.asarray(mean, dtype=np.float64) for label, mean in means.items()}
    options = {label: _options(label) for label in chosen}
    for _ in range(_SWEEPS):
        for label in sorted(chosen, key=lambda one: _reach(chosen[one], one, chosen)):
            best = _reach(chosen[label], label, chosen)
            reaches = _reach(options[label], label, chosen)
            for option, reach in zip(options[label], reaches, strict=True):
                if reach > 1.05 * best:
                    best, chosen[label] = reach, option
    return chosen


def _reach(colors: FloatArray, label: int, chosen: Mapping[int, FloatArray]) -> FloatArray:
    """Distances (...) of a label's colours (..., 3) to the nearest of the others, or to the light."""
    others = [distance(colors, mean) for other, mean in chosen.items() if other != label]
    return np.asarray(np.min([distance_to_light(colors), *others], axis=0))


def _options(label: int) -> FloatArray:
    """Paints (N, 3) [levels] that the name of a label allows."""
    grid = np.meshgrid(NAMED_HUES[label] + _HUES, _SATURATIONS, _LEVELS, indexing="ij")
    return bgr_of_hue(*(axis.ravel() for axis in grid))
