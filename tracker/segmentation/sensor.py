"""What the sensor left in an image: noise, and the pattern of a mosaic that was interpolated.

Cameras with a Bayer filter see blue, green or red at a pixel, and the other two colours there are means of
the neighbours' (`cv2.cvtColor` with `COLOR_Bayer…2BGR`). Such an image obeys these means to the bit.
"""

from __future__ import annotations

import cv2
import numpy as np

from tracker.compiled import compiled
from tracker.conventions import Image

LOUD = 6.0
"""Standard deviation of the noise [levels] above which colours are read from filtered pixels."""

_ROW_STEP, _ROWS = 10, 27
"""Least distance of the rows in which noise is looked for [px], and their number in large pictures."""

_PER_SIGMA = 0.6745 * np.sqrt(6.0)
"""Median of a second difference's size over the noise's standard deviation."""

NO_MOSAIC = -1
"""No mosaic, or one that later changes have made unrecognisable."""

STEP = 5
"""A mosaic is looked for in every so many-th row and column; odd, so that all places of the pattern occur."""

ENOUGH = 100
"""Pixels that differ from their neighbours, that show a mosaic."""


@compiled
def noise_level(image):  # type: ignore[no-untyped-def]
    """Standard deviation [levels] of the noise in an image (H, W, 3) uint8; texture counts as noise.

    From the median second difference of green along some rows.
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
    # Within the level, as if its values were spread evenly.
    share = (0.5 * total - running) / max(counts[level], 1)
    return max(0.0, level - 0.5 + share) / _PER_SIGMA


def calmed(image: Image) -> Image:
    """The image, or where it is loud a median of each pixel and its neighbours."""
    if noise_level(image) < LOUD:
        return image
    return np.asarray(cv2.medianBlur(image, 3), dtype=np.uint8)


@compiled
def _obeys(image, j, i, red):  # type: ignore[no-untyped-def]
    """Whether a pixel's colours are means of what its neighbours measured."""
    has_red, in_column = (j & 1) == red >> 1, (i & 1) == (red & 1)
    if has_red == in_column:
        # It measured red or blue.
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
    """Which pixels of a mosaic measured red: 2 · (their row is odd) + (their column is odd), or NO_MOSAIC.

    Green is where one of both differs, blue where both do.

    Args:
        image: (H, W, 3) uint8 BGR.
    """
    height, width = image.shape[0], image.shape[1]
    for red in range(4):
        differing, fits = 0, True
        for j in range(2, height - 2, STEP):
            for i in range(2, width - 2, STEP):
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
            if not fits or differing >= ENOUGH:
                break
        if fits and differing >= ENOUGH:
            return red
    return NO_MOSAIC
