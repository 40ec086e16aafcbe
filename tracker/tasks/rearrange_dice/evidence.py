"""Evidence for dice: whether a pixel shows a die, its top or a side, a pip or the area between pips.

The evidence is projected into the plane of the dice's tops, where squares of a die's size are proposed.
"""

import functools
from collections.abc import Iterable, Sequence

import cv2
import numpy as np

from tracker.conventions import Array, FloatArray, Image
from tracker.geometry.camera import Camera
from tracker.tasks.rearrange_dice.goals import DIE_WIDTH

SHADE = 0.6
"""Gain if a top explains a pixel as bright as the tops, loss if a side does; vice versa for dark ones."""

PIP = 1.5
"""Loss if the rim of a face, which has no pips, explains a pixel as pale as a pip; if another part of a face
does, the gain is half as large."""

PALENESS = 0.3
"""Difference between the ratio of red to blue in a pip and that in the dice's blue."""

OUTLINE = 0.3
"""Weight of the mask's outermost pixels, which may not show dice if the mask is generous."""

MIN_PIXELS = 50
"""Smallest number of dice pixels in an image at which their brightness is used."""

NOTHING, DICE, UNKNOWN = range(3)
"""Values of a pixel in a mask."""


def evidence(mask: Array, image: Image | None) -> tuple[Array, Image, Array]:
    """Return the evidence in a mask (H, W) of dice, and in its BGR image (H, W, 3) if there is one.

    (5, H, W) float32: score of a pixel if NONE, SIDE, SIDE_RIM, TOP, TOP_RIM explains it;
    (H, W) uint8: NOTHING or DICE; and
    (H, W) float32: from -1, as dark as the sides, to 1, as bright as the tops; 0 if unknown.
    """
    seen = (mask > 0).astype(np.uint8)
    inner = np.asarray(cv2.erode(seen, np.ones((3, 3), np.uint8)), dtype=np.uint8)
    shade = pale = np.zeros(seen.shape, np.float32)
    if image is not None and np.count_nonzero(inner) >= MIN_PIXELS:
        pale = _paleness(image, inner)
        shade = _shade(image, seen, inner) * (1 - pale)
    weight = np.where(inner > 0, np.float32(1), np.float32(OUTLINE))
    tops, pips = SHADE * shade, PIP * pale
    scores = np.zeros((5, *seen.shape), np.float32)
    for k, score in enumerate((1 - tops + pips / 2, 1 - tops - pips, 1 + tops + pips / 2, 1 + tops - pips)):
        scores[k + 1] = np.where(seen > 0, weight * score, np.float32(-1))
    return scores, seen, shade


def _shade(image: Image, seen: Image, inner: Image) -> Array:
    """Return the brightness of the dice's blue, -1 to 1: the means of its dark and bright classes (Otsu)."""
    blue = image[..., 0]
    levels = blue[inner > 0]
    border, _ = cv2.threshold(levels[:, None], 0, 255, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
    bright, dark = levels[levels > border], levels[levels <= border]
    if not (len(bright) and len(dark)):
        return np.zeros(seen.shape, np.float32)
    high, low = float(bright.mean()), float(dark.mean())
    shade = (blue.astype(np.float32) - (high + low) / 2) * (2 / (high - low))
    return np.where(seen > 0, np.clip(shade, -1, 1), np.float32(0))


def _paleness(image: Image, inner: Image) -> Array:
    """Return paleness from 0, blue, to 1, a pip; 0 at the mask's edge, where blue mixes with surroundings."""
    ratio = (image[..., 2] + np.float32(5)) / (image[..., 0] + np.float32(5))
    usual = np.float32(np.median(ratio[inner > 0]))
    return np.where(inner > 0, np.clip((ratio - usual) / np.float32(PALENESS), 0, 1), np.float32(0))


def tops(masks: Image, shades: Array) -> Array:
    """Rate pixels (C, H, W) float32: from -0.7 (no dice) to 1 (as bright as a die's top); 0 if unknown."""
    shaded = shades.any(axis=(1, 2), keepdims=True)
    seen = np.where(shaded, 0.4 + 0.6 * shades, np.float32(0.5))
    return np.choose(masks, (np.float32(-0.7), seen, np.float32(0))).astype(np.float32)


CELL = 0.002
"""Edge length of the plane's cells [m]."""

REACH = 0.196
"""Radius around the arena's centre beyond which no die reaches [m]."""

LEVELS = 2
"""Number of planes: the tops of dice on the table, and of dice on these."""

STACKED = 0.25
"""Penalty on the evidence for a die on top of another, as a share of the largest possible evidence."""

ENOUGH = 0.15
"""Smallest evidence for a proposed square, as a share of the largest possible."""

BORDER = 0.003
"""Width of a square's outline [m]."""

SLACK = 0.0005
"""Width by which neighbours may overlap a proposed square [m]."""

STYLES = ((0.5, 0.0), (0.9, 0.0), (0.5, 7.5))
"""Ways to fill a crowd with squares: weight of the outline, and first yaw [°]."""

_COUNT = 2 * round(0.2 / CELL)
_LINE = (np.arange(_COUNT) - (_COUNT - 1) / 2) * CELL
_X, _Y = np.meshgrid(_LINE, _LINE)
_HALF = int(np.ceil((DIE_WIDTH / 2 + BORDER) * np.sqrt(2) / CELL))
"""Cells from the middle of a square to the farthest corner of its outline."""


class Plan:
    """The planes of tops above a table at a given height [m] in the world; maps cells to camera pixels."""

    def __init__(self, cameras: Sequence[Camera], table: float = 0.0) -> None:
        heights = [table + (k + 1) * DIE_WIDTH for k in range(LEVELS)]
        self._maps = [[_pixels(camera, height) for camera in cameras] for height in heights]
        self.cameras, self.table = cameras, table

    def project(self, ratings: Iterable[Array], known: int) -> list[Array]:
        """Return a plane (N, N) for each level: mean ratings (H, W) of its cells, over `known` cameras."""
        planes = []
        for maps in self._maps:
            plane = np.zeros_like(_X, dtype=np.float32)
            for rating, where in zip(ratings, maps, strict=True):
                plane += cv2.remap(rating, *where, cv2.INTER_LINEAR) / max(known, 1)
            plane[np.hypot(_X, _Y) > REACH] = -1
            planes.append(plane)
        return planes

    def propose(self, planes: Sequence[Array], style: int, most: int, enough: float = ENOUGH) -> FloatArray:
        """Propose up to `most` dice (N, 4) as (x, y, foot, yaw), best first: squares of well-rated cells.

        A square scores higher if nothing lies along its outline. Cells of a proposed square do not count for
        others, so that a crowd is filled corner by corner, in a different order for each of STYLES, given by
        its number. Planes (N, N) are rated from -1 to 1; squares rated below `enough` are not proposed.
        """
        squares, yaws = _templates(style)
        planes = [plane.copy() for plane in planes]
        fit = np.stack([[_filter(plane, square) for square in squares] for plane in planes])
        fit -= STACKED * np.arange(len(planes), dtype=np.float32)[:, None, None, None]
        best = fit.max(axis=1)
        dice: list[tuple[float, ...]] = []
        while len(dice) < most:
            k, j, i = (int(n) for n in np.unravel_index(np.argmax(best), best.shape))
            if best[k, j, i] < enough:
                break
            yaw = float(yaws[np.argmax(fit[k, :, j, i])])
            dice.append((_LINE[i], _LINE[j], self.table + k * DIE_WIDTH, yaw))
            part = _around(j, i, _HALF)
            taken = _distance(_X[part] - _LINE[i], _Y[part] - _LINE[j], yaw) <= DIE_WIDTH / 2 - SLACK
            planes[k][part][taken] = -1
            changed, needed = _around(j, i, 2 * _HALF), _around(j, i, 3 * _HALF)
            inner = tuple(
                slice(a.start - b.start, a.stop - b.start) for a, b in zip(changed, needed, strict=True)
            )
            for n, square in enumerate(squares):
                fit[(k, n, *changed)] = _filter(planes[k][needed], square)[inner] - STACKED * k
            best[(k, *changed)] = fit[(k, slice(None), *changed)].max(axis=0)
        return np.array(dice, dtype=np.float64).reshape(-1, 4)


def _pixels(camera: Camera, height: float) -> tuple[Array, Array]:
    """Return pixel columns and rows (N, N) of the cells' centres at a height [m]; far outside if not seen."""
    points = np.stack([_X, _Y, np.full_like(_X, height)], axis=-1).reshape(-1, 3)
    pixels = np.nan_to_num(camera.project_in_view(points), nan=-1e4).astype(np.float32)
    columns, rows = pixels.T.reshape(2, _COUNT, _COUNT)
    return np.ascontiguousarray(columns), np.ascontiguousarray(rows)


def _around(j: int, i: int, reach: int) -> tuple[slice, slice]:
    rows, columns = (slice(max(n - reach, 0), min(n + reach + 1, _COUNT)) for n in (j, i))
    return rows, columns


def _filter(plane: Array, square: Array) -> Array:
    return np.asarray(cv2.filter2D(plane, -1, square, borderType=cv2.BORDER_CONSTANT))


def _distance(x: Array, y: Array, yaw: float) -> Array:
    """Return the larger distance from the origin along the two axes of a square turned by yaw [rad]."""
    cos, sin = np.cos(yaw), np.sin(yaw)
    return np.asarray(np.maximum(np.abs(cos * x + sin * y), np.abs(cos * y - sin * x)))


@functools.cache
def _templates(style: int) -> tuple[list[Array], FloatArray]:
    """Return filter kernels of squares with outlines, and their yaws [rad]."""
    outline, first = STYLES[style]
    yaws = np.radians(first + np.arange(0.0, 90.0, 15.0))
    line = np.arange(-_HALF, _HALF + 1) * CELL
    x, y = np.meshgrid(line, line)
    squares = []
    for yaw in yaws:
        distance = _distance(x, y, yaw)
        inside = distance <= DIE_WIDTH / 2
        square = np.where(inside, 1.0, np.where(distance <= DIE_WIDTH / 2 + BORDER, -outline, 0.0))
        squares.append((square / np.count_nonzero(inside)).astype(np.float32))
    return squares, yaws
