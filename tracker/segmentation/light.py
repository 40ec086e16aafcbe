"""Normalise the light of an image: scale its channels so that the scene's greys become one grey.

First, the veil that stray light or a camera's black level lays over the whole image is removed.

The platform is grey almost everywhere (wall, table, robot), so the most frequent chromaticity is
that of grey under this camera's white balance. The mean of these grey pixels gives the channel gains, and the
brighter ones give the exposure.
"""

import math
from dataclasses import dataclass

import cv2
import numpy as np

from tracker.compiled import compiled
from tracker.conventions import FloatArray, Image
from tracker.segmentation.sensor import NO_MOSAIC, find_mosaic, interpolated

TARGET_GREY = 115.0
"""Level to which the scene's greys are scaled."""

SAMPLES = 1200
"""Approximate number of pixels sampled; more do not change the result by a level."""

CLIPPED = 250
"""Level from which a channel may be clipped."""

BRIGHTNESS_RANK = 0.7
"""Quantile of the greys' brightness that is scaled to TARGET_GREY: the wall, even if all else is dark."""

MIN_GREYS = 20
"""Smallest number of grey samples; with fewer, no grey is found."""

STAGE_ROUNDS = 2
"""Rounds in each stage of the fit: without a slope of the chromaticity, with one, and the last."""

MIN_TILT = 0.05
"""Slope of the log chromaticity from middle to corner below which the light counts as even."""

LEAST_BLACK = 8
"""Smallest level of an image's darkest pixels that a veil may have lifted."""

DENSEST = 128
"""Level of the darkest pixels above which it is not due to a veil: the image is overexposed."""

DARKEST = 8000
"""One pixel in this many is taken for black: even in a scene without anything black, at least so many show
the dark channels of a saturated object."""

_BINS = 56
_RANGE = 1.75
_LOG = np.log(np.maximum(np.arange(256), 0.5))


@compiled
def black_level(image):  # type: ignore[no-untyped-def]
    """Return the level of the darkest channel of an image's darkest pixels; 0 if it is below LEAST_BLACK."""
    step = max(1, min(image.shape[0], image.shape[1]) // 270)
    enough = image.shape[0] * image.shape[1] // (DARKEST * step * step) + 1
    levels, dark = np.zeros(256, np.int64), 0
    for j in range(0, image.shape[0], step):
        for i in range(0, image.shape[1], step):
            low = min(image[j, i, 0], image[j, i, 1], image[j, i, 2])
            levels[low] += 1
            dark += low < LEAST_BLACK
            if dark == enough:
                return 0
    level = LEAST_BLACK
    while dark + levels[level] < enough:
        dark += levels[level]
        level += 1
    return level


def unveiled(image: Image) -> Image:
    """Return the image (H, W, 3) uint8 without its veil, white as before; the same image if it has none.

    An interpolated mosaic stays one.
    """
    black = black_level(image)
    veil = min(black, 2 * (black - LEAST_BLACK))  # less of a faint one, so that images do not flicker
    if not 0 < veil <= DENSEST:
        return image
    levels = np.rint(np.arange(-veil, 256 - veil) * (255 / (255 - veil)))
    without = np.asarray(cv2.LUT(image, np.maximum(levels, 0).astype(np.uint8)), dtype=np.uint8)
    red = find_mosaic(image)
    return without if red == NO_MOSAIC else interpolated(without, red)


@compiled
def _sample(image, step, points, clipped):  # type: ignore[no-untyped-def]
    """Fill points (5, N): log chroma b/g and r/g, x and y from -1 to 1, level of green; return N.

    Clipped greys have no known chromaticity: they are counted by their level of green in clipped (256,).
    """
    height, width = image.shape[0], image.shape[1]
    count = 0
    for j in range(step // 2, height, step):
        for i in range(step // 2, width, step):
            b, g, r = image[j, i, 0], image[j, i, 1], image[j, i, 2]
            high, low = max(b, g, r), min(b, g, r)
            if high >= CLIPPED:
                clipped[g] += low > 100
                continue
            if low < 6 or high < 12:
                continue
            points[0, count], points[1, count] = _LOG[b] - _LOG[g], _LOG[r] - _LOG[g]
            points[2, count], points[3, count] = 2.0 * i / width - 1.0, 2.0 * j / height - 1.0
            points[4, count] = g
            count += 1
    return count


@compiled
def _mode(points, count):  # type: ignore[no-untyped-def]
    """Return the most frequent log chroma (u, v), to the width of a bin."""
    histogram = np.zeros((_BINS + 2, _BINS + 2), np.int32)
    scale = _BINS / (2 * _RANGE)
    for n in range(count):
        u, v = (points[0, n] + _RANGE) * scale, (points[1, n] + _RANGE) * scale
        if 0 <= u < _BINS and 0 <= v < _BINS:
            histogram[int(u) + 1, int(v) + 1] += 1
    best, u0, v0 = -1, 0, 0
    columns = np.empty(_BINS + 2, np.int32)
    for iu in range(1, _BINS + 1):
        for iv in range(_BINS + 2):
            columns[iv] = histogram[iu - 1, iv] + histogram[iu, iv] + histogram[iu + 1, iv]
        for iv in range(1, _BINS + 1):
            total = columns[iv - 1] + columns[iv] + columns[iv + 1]
            if total > best:
                best, u0, v0 = total, iu, iv
    return (u0 - 0.5) / scale - _RANGE, (v0 - 0.5) / scale - _RANGE


@compiled(fastmath={"reassoc", "contract", "nsz"})
def _sums(points, count, plane, reach):  # type: ignore[no-untyped-def]
    """Return the number of points near a plane, and sums over them: x, y, xx, xy, yy, u, ux, uy, v, vx, vy.

    u and v are the points' residuals from the plane. The order of summation is not fixed, for speed.
    """
    number, mx, my, xx, xy, yy = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    u, ux, uy, v, vx, vy = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    a, b, c = plane[0, 0], plane[0, 1], plane[0, 2]
    d, e, f = plane[1, 0], plane[1, 1], plane[1, 2]
    for n in range(np.uint64(count)):
        x, y = points[2, n], points[3, n]
        du = points[0, n] - a - b * x - c * y
        dv = points[1, n] - d - e * x - f * y
        # A factor instead of a branch, which would prevent vectorisation.
        near = 1.0 if max(abs(du), abs(dv)) < reach else 0.0
        du, dv = near * du, near * dv
        number += near
        mx += near * x
        my += near * y
        xx += near * x * x
        xy += near * x * y
        yy += near * y * y
        u += du
        ux += du * x
        uy += du * y
        v += dv
        vx += dv * x
        vy += dv * y
    return number, mx, my, xx, xy, yy, u, ux, uy, v, vx, vy


@compiled
def _fit_plane(points, count, plane, reach, flat):  # type: ignore[no-untyped-def]
    """Fit plane (2, 3) to the points near it, in place; return their number, or 0 if there are too few.

    The plane's rows are the coefficients of 1, x, y for the two log chromas. flat: only the constants change.
    """
    inside, mx, my, xx, xy, yy, u, ux, uy, v, vx, vy = _sums(points, count, plane, reach)
    if inside < MIN_GREYS:
        return 0
    if flat:
        plane[0, 0] += u / inside
        plane[1, 0] += v / inside
        return int(inside)
    # Eliminate the constant, then solve for the two slopes with a weak ridge.
    mx, my = mx / inside, my / inside
    xx, yy = xx - inside * mx * mx + 0.02 * inside, yy - inside * my * my + 0.02 * inside
    xy -= inside * mx * my
    determinant = xx * yy - xy * xy
    for k in range(2):
        off = u if k == 0 else v
        bx, by = (ux if k == 0 else vx) - mx * off, (uy if k == 0 else vy) - my * off
        sx, sy = (yy * bx - xy * by) / determinant, (xx * by - xy * bx) / determinant
        plane[k, 0] += off / inside - sx * mx - sy * my
        plane[k, 1] += sx
        plane[k, 2] += sy
    return int(inside)


@compiled
def _greys(image, step, points, plane):  # type: ignore[no-untyped-def]
    """Fill plane (2, 3) with the log chroma of the scene's greys; return their level of green and share."""
    plane[:], levels = 0.0, np.zeros(256, np.int64)
    count = _sample(image, step, points, levels)
    if count < 50:
        return 0.0, 0.0
    plane[0, 0], plane[1, 0] = _mode(points, count)
    middle, inside, flat = (plane[0, 0], plane[1, 0]), 0, True
    # The last rounds keep the slope unless it is slight.
    for turn in range(3 * STAGE_ROUNDS):
        sloping = turn // STAGE_ROUNDS == 1
        if turn == 2 * STAGE_ROUNDS:
            tilt = max(abs(plane[0, 1]) + abs(plane[0, 2]), abs(plane[1, 1]) + abs(plane[1, 2]))
            flat = tilt < MIN_TILT
            if flat:
                plane[:] = 0.0
                plane[0, 0], plane[1, 0] = middle
        reach = 0.22 if turn == 0 else 0.2 if sloping else 0.15
        inside = _fit_plane(points, count, plane, reach, flat and not sloping)
        if inside == 0:
            return 0.0, 0.0
        if turn == 0:
            middle = plane[0, 0], plane[1, 0]
    for n in range(count):
        x, y = points[2, n], points[3, n]
        du = points[0, n] - plane[0, 0] - plane[0, 1] * x - plane[0, 2] * y
        dv = points[1, n] - plane[1, 0] - plane[1, 1] * x - plane[1, 2] * y
        if abs(du) < 0.15 and abs(dv) < 0.15:
            levels[int(points[4, n])] += 1
    total, running, level = 0, 0, 0
    for k in range(256):
        total += levels[k]
    below = int(total * BRIGHTNESS_RANK)
    while running <= below:
        running += levels[level]
        level += 1
    return level - 1.0, inside / count


@compiled
def fill_light(image, gains, tilt):  # type: ignore[no-untyped-def]
    """Fill gains (3,) and tilt (2, 2) of Light if greys are found; return their share of pixels, else 0."""
    step = max(1, int(math.sqrt(image.shape[0] * image.shape[1] / SAMPLES)))
    points = np.empty((5, ((image.shape[0] // step) + 1) * ((image.shape[1] // step) + 1)))
    plane = np.empty((2, 3))
    green, share = _greys(image, step, points, plane)
    if green <= 0.0:
        return 0.0
    for k in range(3):
        chroma = 0.0 if k == 1 else plane[k // 2, 0]
        gains[k] = TARGET_GREY / (green * math.exp(chroma))
    for k in range(2):
        tilt[k, 0], tilt[k, 1] = plane[k, 1], plane[k, 2]
    return share


@dataclass(frozen=True, eq=False)
class Light:
    """The light in an image, estimated from its greys."""

    gains: FloatArray
    """(3,) factors that scale grey in the image's middle to TARGET_GREY; 1 if no grey is found (black, white,
    monochrome)."""
    tilt: FloatArray
    """(2, 2) slopes of ln(blue/green) and ln(red/green), per half image to the right and down; 0: even."""
    share: float
    """Share of greys among the pixels that are neither dark nor clipped; 0 if no grey is found."""


def find_light(image: Image) -> Light:
    """Estimate the light in an image (H, W, 3) uint8 from its most frequent chromaticity.

    This is equation (1) of docs/how-it-works.md.
    """
    gains, tilt = np.ones(3), np.zeros((2, 2))
    share = fill_light(image, gains, tilt)
    return Light(gains, tilt, float(share))


@compiled
def evened_level(level, factor):  # type: ignore[no-untyped-def]
    """Return a level times a factor; a clipped level stays clipped, since its true value is unknown."""
    return 255 if level >= CLIPPED else min(int(level * factor + 0.5), CLIPPED - 1)


@compiled
def even_out(levels, factors):  # type: ignore[no-untyped-def]
    """Multiply levels (H, W) by factors (H, W), in place."""
    for j in range(levels.shape[0]):
        for i in range(levels.shape[1]):
            levels[j, i] = evened_level(levels[j, i], factors[j, i])


def evened(image: Image, light: Light) -> Image:
    """Return the image (H, W, 3) with the light's tilt removed; the same image if it has none."""
    if not light.tilt.any():
        return image
    y, x = (2.0 * np.arange(size) / size - 1.0 for size in image.shape[:2])
    out = image.copy()
    for channel, slope in zip((0, 2), light.tilt, strict=True):
        even_out(out[..., channel], np.outer(np.exp(-slope[1] * y), np.exp(-slope[0] * x)))
    return out


def apply_gains(image: Image, gains: FloatArray) -> Image:
    """Return the image with its channels multiplied by `gains` (3,), rounded and clipped to 8 bits."""
    levels = np.arange(256)[:, None] * np.asarray(gains)[None, :]
    tables = np.clip(np.rint(levels), 0, 255).astype(np.uint8)
    return np.asarray(cv2.LUT(image, tables[None]), dtype=np.uint8)
