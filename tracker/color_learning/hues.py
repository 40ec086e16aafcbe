"""The colours of faces: the hues that their names imply, and the distances between them.

Cameras see paints, not pure colours: in labelled images of the platform's objects in neutral light, red
is at 7 to 26°, yellow at 47 to 57°, green at 79 to 120°, cyan at 174 to 190°, blue at 206 to 216° and
magenta at 291 to 349°.

The distance of two colours is a Mahalanobis distance of log blue, green and red in neutral light, with the
covariance of the changes that light, shade and camera cause.
"""

from collections.abc import Mapping, Sequence

import cv2
import numpy as np
from scipy.optimize import linear_sum_assignment

from tracker.color_learning.labelled import LabelledImage, neutral
from tracker.conventions import Array, FloatArray
from tracker.segmentation.color_model import CLASSES, NODES, ColorModel

NAMED_HUES: FloatArray = np.array([np.nan, 12.0, 100.0, 212.0, 178.0, 312.0, 52.0])
"""(7,) hue that each label's name implies [degrees]; label 0 has none."""

MAX_OFF = 45.0
"""Largest accepted deviation of a hue from that of its name [degrees]."""

MAX_GAIN = 30.0
"""Names count as wrong if permuting them reduces the summed deviations by more than this [degrees]."""

BRIGHTNESS, CHANNEL, LEVEL = 0.35, 0.07, 6.0
"""Standard deviations of the log of a face's brightness (light and shade), of the log of each channel, and of
the level that haze and noise add [levels]."""

NEAR = 4.0
"""Distance below which two colours are occasionally confused [standard deviations]."""

MOST = 4000
"""Largest number of pixels kept per colour."""

LIGHT = 0
"""Label for the colour of the light, which is that of all greys, in pairs of colours."""

_HUES, _SATURATIONS, _LEVELS = np.arange(-20.0, 21.0, 10.0), (0.6, 0.75, 0.9), (70.0, 110.0, 160.0, 210.0)


def hue_of(pixels: Array) -> float:
    """Return the hue [degrees] of the median of pixels (N, 3) BGR in neutral light; NaN if it is grey.

    Pixels count relative to their brightest channel: the median of bright and dark ones has a hue of its own.
    """
    levels = np.asarray(pixels, dtype=np.float64)
    blue, green, red = np.median(levels / np.maximum(levels.max(axis=1, keepdims=True), 1.0), axis=0)
    # The two axes of the colour hexagon: the hue is the angle.
    along, across = red - 0.5 * (green + blue), np.sqrt(0.75) * (green - blue)
    if np.hypot(along, across) < 0.01:
        return float("nan")
    return float(np.degrees(np.arctan2(across, along)) % 360.0)


def hues_of_model(colors: ColorModel) -> dict[int, float]:
    """Return the median hue [degrees] of what a colour model labels as each face colour that it knows."""
    best = np.argmax(colors.log_posterior, axis=0)
    nodes = {label: np.argwhere(best == label) for label in range(1, CLASSES)}
    return {label: hue_of(255.0 * (its / (NODES - 1)) ** 2) for label, its in nodes.items() if len(its)}


def bgr_of_hue(hues: FloatArray, saturations: FloatArray, levels: FloatArray) -> FloatArray:
    """Return pixels (N, 3) BGR for hues [degrees], saturations up to 1, levels of the brightest channel."""
    pixels = np.stack([hues % 360.0, saturations, levels], axis=-1, dtype=np.float32)
    return np.asarray(cv2.cvtColor(pixels[None], cv2.COLOR_HSV2BGR)[0], dtype=np.float64)


def hue_distance(a: Array | float, b: Array | float) -> FloatArray:
    """Return the smallest angle between hues [degrees]."""
    turn = np.abs(np.asarray(a, dtype=np.float64) - b) % 360.0
    return np.asarray(np.minimum(turn, 360.0 - turn), dtype=np.float64)


def misnamed(hues: Mapping[int, float]) -> dict[int, int]:
    """Return labels whose hue does not match their name, each with the other label whose name comes nearest.

    Either a hue is too far from that of its name, or a permutation of the names among the given labels
    would match much better. Hues by label are in degrees; NaN is grey, which matches no name: label 0.
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
            others = np.where(np.arange(CLASSES) == label, np.nan, NAMED_HUES)
            wrong[label] = int(np.nanargmin(hue_distance(hue, others)))
    return wrong


def paints(images: Sequence[LabelledImage]) -> tuple[dict[int, Array], FloatArray]:
    """Return the colours of labelled images, and their light.

    The former are levels (N, 3) BGR in neutral light by label; the latter is the BGR (3,) of the images'
    greys before normalisation, scaled to a maximum of 1.
    """
    found: dict[int, list[Array]] = {}
    lights = []
    for one in images:
        levels, light = neutral(one.image)
        lights.append(np.log(light.gains[1] / light.gains))
        for label in np.unique(one.labels[one.labels > 0]):
            found.setdefault(int(label), []).append(levels[one.labels == label])
    raw = np.exp(np.median(lights, axis=0))
    joined = {label: np.concatenate(some) for label, some in sorted(found.items())}
    return {label: some[:: len(some) // MOST + 1] for label, some in joined.items()}, raw / raw.max()


def distance(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return distances (...) between colours (..., 3) [levels], in standard deviations; see the module."""
    difference = np.log(a + LEVEL) - np.log(b + LEVEL)
    own = CHANNEL**2 + 0.5 * ((LEVEL / (a + LEVEL)) ** 2 + (LEVEL / (b + LEVEL)) ** 2)
    covariance = BRIGHTNESS**2 + own[..., None] * np.eye(3)
    scaled = np.linalg.solve(covariance, difference[..., None])[..., 0]
    return np.asarray(np.sqrt((difference * scaled).sum(axis=-1)))


def distance_to_light(colors: FloatArray) -> FloatArray:
    """Return distances (...) of colours (..., 3) [levels] to the nearest grey of any brightness."""
    return np.asarray(distance(colors[..., None, :], np.geomspace(8.0, 240.0, 40)[:, None]).min(axis=-1))


def distances(means: Mapping[int, FloatArray]) -> dict[tuple[int, int], float]:
    """Return the distances of all pairs of colours, and of each to the light as (LIGHT, label)."""
    labels = sorted(means)
    pairs = {(a, b): float(distance(means[a], means[b])) for a in labels for b in labels if a < b}
    return {(LIGHT, label): float(distance_to_light(means[label])) for label in labels} | pairs


def better_set(means: Mapping[int, FloatArray]) -> dict[int, FloatArray]:
    """Return colours (3,) [levels] with the same names whose smallest distance is as large as possible.

    Each colour in turn is moved to the paint within 20° of its name's hue that is farthest from its nearest
    neighbour, if that gains more than 5 %.
    """
    chosen = {label: np.asarray(mean, dtype=np.float64) for label, mean in means.items()}
    options = {label: _options(label) for label in chosen}
    for _ in range(4):
        for label in sorted(chosen, key=lambda one: _reach(chosen[one], one, chosen)):
            best = _reach(chosen[label], label, chosen)
            reaches = _reach(options[label], label, chosen)
            if reaches.max() > 1.05 * best:
                chosen[label] = options[label][reaches.argmax()]
    return chosen


def _reach(colors: FloatArray, label: int, chosen: Mapping[int, FloatArray]) -> FloatArray:
    """Return distances (...) of a label's colours (..., 3) to the nearest other colour or the light."""
    others = [distance(colors, mean) for other, mean in chosen.items() if other != label]
    return np.asarray(np.min([distance_to_light(colors), *others], axis=0))


def _options(label: int) -> FloatArray:
    """Return the paints (N, 3) [levels] that the name of a label allows."""
    grid = np.meshgrid(NAMED_HUES[label] + _HUES, _SATURATIONS, _LEVELS, indexing="ij")
    return bgr_of_hue(*(axis.ravel() for axis in grid))
