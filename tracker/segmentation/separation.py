"""How far apart the colours of an object's faces are, from each other and from the light, and a better set.

A colour is a point of log blue, green, red in neutral light. Two are as far apart as light, shade and
camera may move one towards the other: distances are counted in standard deviations of that.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tracker.conventions import Array, FloatArray
from tracker.segmentation.hues import NAMED_HUES, bgr_of_hue
from tracker.segmentation.labelled import LabelledImage
from tracker.segmentation.light import apply_gains, evened, find_light

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


def distance(a: FloatArray, b: FloatArray) -> float:
    """Distance of two colours (3,) [levels], in standard deviations of what light and camera do."""
    difference = _log(a) - _log(b)
    return float(np.sqrt(difference @ np.linalg.solve(_spread(a) + _spread(b), difference) * 2.0))


def distance_to_light(color: FloatArray) -> float:
    """Distance of a colour (3,) [levels] to the nearest grey of any brightness."""
    return min(distance(color, np.full(3, level)) for level in np.geomspace(8.0, 240.0, 40))


def distances(means: Mapping[int, FloatArray]) -> dict[tuple[int, int], float]:
    """Distances of all pairs of colours, and of each to the light as (LIGHT, label)."""
    labels = sorted(means)
    pairs = {(a, b): distance(means[a], means[b]) for a in labels for b in labels if a < b}
    return {(LIGHT, label): distance_to_light(means[label]) for label in labels} | pairs


def better_set(means: Mapping[int, FloatArray]) -> dict[int, FloatArray]:
    """Colours (3,) [levels] with the same names whose smallest distance is as large as can be.

    One colour after the other is moved to where it is farthest from its nearest neighbour, among paints
    within 20° of its name's hue; those that nothing is gained for stay.
    """
    chosen = {label: np.asarray(mean, dtype=np.float64) for label, mean in means.items()}
    options = {label: _options(label) for label in chosen}
    alone = {label: [distance_to_light(one) for one in options[label]] for label in chosen}
    for _ in range(_SWEEPS):
        for label in sorted(chosen, key=lambda one: _nearest(chosen[one], one, chosen)):
            others = [mean for other, mean in chosen.items() if other != label]
            best = _nearest(chosen[label], label, chosen)
            for option, far in zip(options[label], alone[label], strict=True):
                reach = min([far, *(distance(option, other) for other in others)])
                if reach > 1.05 * best:
                    best, chosen[label] = reach, option
    return chosen


def _nearest(color: FloatArray, label: int, colors: Mapping[int, FloatArray]) -> float:
    """Distance of a label's colour to the nearest other one, or to the light."""
    others = [distance(color, mean) for other, mean in colors.items() if other != label]
    return min([distance_to_light(color), *others])


def _options(label: int) -> list[FloatArray]:
    """Paints (3,) [levels] that the name of a label allows."""
    return [
        bgr_of_hue(np.array([hue]), np.array([saturation]), np.array([level]))[0]
        for hue in NAMED_HUES[label] + _HUES
        for saturation in _SATURATIONS
        for level in _LEVELS
    ]


def _log(color: FloatArray) -> FloatArray:
    return np.asarray(np.log(color + LEVEL), dtype=np.float64)


def _spread(color: FloatArray) -> FloatArray:
    """(3, 3) covariance of the log of a colour."""
    added = LEVEL / (color + LEVEL)
    return np.asarray(BRIGHTNESS**2 + np.diag(CHANNEL**2 + added**2), dtype=np.float64)
