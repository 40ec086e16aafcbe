"""Noise: how much an image has, and labels that bear it."""

from __future__ import annotations

import cv2
import numpy as np

from tracker.compiled import compiled
from tracker.conventions import Image

LOUD = 6.0
"""Standard deviation of the noise [levels] above which colours are read from filtered pixels."""

_ROW_STEP, _ROWS = 10, 27
_PER_SIGMA = 0.6745 * np.sqrt(6.0)
"""Median of a second difference's size over the noise's standard deviation."""


@compiled
def noise_std(image):  # type: ignore[no-untyped-def]
    """As `noise_level`, compiled: from the median second difference of green along some rows."""
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


def noise_level(image: Image) -> float:
    """Standard deviation [levels] of the noise in an image (H, W, 3) uint8; texture counts as noise."""
    return float(noise_std(image))


def calmed(image: Image) -> Image:
    """The image, or where it is loud a median of each pixel and its neighbours."""
    if noise_level(image) < LOUD:
        return image
    return np.asarray(cv2.medianBlur(image, 3), dtype=np.uint8)
