"""Traces of the sensor in an image: noise, and the pattern of an interpolated Bayer mosaic.

Cameras with a Bayer filter measure blue, green or red at a pixel; the other two colours are means of the
neighbours' (`cv2.cvtColor` with `COLOR_Bayer…2BGR`). In such an image these means are exact to the bit.
"""

import cv2
import numpy as np

from tracker.compiled import compiled
from tracker.conventions import FloatArray, Image

LOUD = 6.0
"""Standard deviation of the noise above which colours are read from median-filtered pixels [levels]."""

_ROW_STEP, _ROWS = 20, 14
"""Smallest spacing of the rows in which noise is measured [px], and their number in large images."""

_PER_SIGMA = 0.6745 * np.sqrt(6.0)
"""Median absolute second difference divided by the noise's standard deviation."""

NO_MOSAIC = -1
"""No mosaic, or one that later changes have made unrecognisable."""

MOSAIC_STEP = 5
"""Spacing of the rows and columns tested for a mosaic [px]; odd, to reach all positions in the pattern."""

ENOUGH_PIXELS = 100
"""Number of pixels, not equal to their neighbours, that must all fit a mosaic for it to be detected."""


@compiled
def noise_level(image):  # type: ignore[no-untyped-def]
    """Return the standard deviation [levels] of the noise in an image (H, W, 3) uint8, texture included.

    It comes from the median absolute second difference of green along some rows.
    """
    row_step = max(_ROW_STEP, image.shape[0] // _ROWS)
    counts = np.zeros(1024, np.int64)
    total = 0
    for j in range(row_step // 2, image.shape[0], row_step):
        for i in range(1, image.shape[1] - 1):
            bend = 2 * np.int64(image[j, i, 1]) - np.int64(image[j, i - 1, 1]) - np.int64(image[j, i + 1, 1])
            counts[abs(bend)] += 1
            total += 1
    running, level = 0, 0
    while 2 * (running + counts[level]) < total:
        running += counts[level]
        level += 1
    # Interpolate the median within its level.
    share = (0.5 * total - running) / max(counts[level], 1)
    return max(0.0, level - 0.5 + share) / _PER_SIGMA


def calmed(image: Image, gains: FloatArray) -> Image:
    """Return the image, median-filtered (3×3) if it is noisy in the light in which its colours are read.

    gains: (3,) of that light.
    """
    if noise_level(image) * gains.min() < LOUD:
        return image
    return np.asarray(cv2.medianBlur(image, 3), dtype=np.uint8)


@compiled
def _obeys(image, j, i, red):  # type: ignore[no-untyped-def]
    """Whether a pixel's two other colours are means of its neighbours', with `red` as in `find_mosaic`."""
    has_red, in_column = (j & 1) == red >> 1, (i & 1) == (red & 1)
    if has_red == in_column:
        # The pixel measured red or blue.
        other = 0 if has_red else 2
        cross = int(image[j, i - 1, 1]) + image[j, i + 1, 1] + image[j - 1, i, 1] + image[j + 1, i, 1]
        corners = int(image[j - 1, i - 1, other]) + image[j - 1, i + 1, other]
        corners += int(image[j + 1, i - 1, other]) + image[j + 1, i + 1, other]
        return image[j, i, 1] == (cross + 2) >> 2 and image[j, i, other] == (corners + 2) >> 2
    beside, above = (2, 0) if has_red else (0, 2)
    left_right = int(image[j, i - 1, beside]) + image[j, i + 1, beside]
    up_down = int(image[j - 1, i, above]) + image[j + 1, i, above]
    return image[j, i, beside] == (left_right + 1) >> 1 and image[j, i, above] == (up_down + 1) >> 1


@compiled
def find_mosaic(image):  # type: ignore[no-untyped-def]
    """Return which pixels of a mosaic measured red: 2 · (odd row) + (odd column), or NO_MOSAIC.

    Green is where either row or column parity differs from red's, blue where both do.

    Args:
        image: (H, W, 3) uint8 BGR.
    """
    height, width = image.shape[0], image.shape[1]
    for red in range(4):
        differing, fits = 0, True
        for j in range(2, height - 2, MOSAIC_STEP):
            for i in range(2, width - 2, MOSAIC_STEP):
                flat = True
                for k in range(3):
                    flat &= image[j, i, k] == image[j, i - 1, k] and image[j, i, k] == image[j, i + 1, k]
                    flat &= image[j, i, k] == image[j - 1, i, k] and image[j, i, k] == image[j + 1, i, k]
                if flat:
                    continue
                fits = _obeys(image, j, i, red)
                if not fits:
                    break
                differing += 1
            if not fits or differing >= ENOUGH_PIXELS:
                break
        if fits and differing >= ENOUGH_PIXELS:
            return red
    return NO_MOSAIC


_INTERPOLATIONS = (
    cv2.COLOR_BayerRGGB2BGR, cv2.COLOR_BayerGRBG2BGR, cv2.COLOR_BayerGBRG2BGR, cv2.COLOR_BayerBGGR2BGR,
)  # fmt: skip


def interpolated(image: Image, red: int) -> Image:
    """Return the image (H, W, 3), interpolated again from what its mosaic measured; red: see `find_mosaic`.

    The border stays as it is, since OpenCV repeats its neighbours there.
    """
    row, column = red >> 1, red & 1
    raw = image[..., 1].copy()
    raw[row::2, column::2] = image[row::2, column::2, 2]
    raw[1 - row :: 2, 1 - column :: 2] = image[1 - row :: 2, 1 - column :: 2, 0]
    result = image.copy()
    result[2:-2, 2:-2] = cv2.cvtColor(raw, _INTERPOLATIONS[red])[2:-2, 2:-2]
    return result
