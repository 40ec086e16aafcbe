"""Which colours are taken for which."""

from __future__ import annotations

from collections.abc import Iterable

import cv2
import numpy as np

from tracker.conventions import Array, Image
from tracker.segmentation.color_model import CLASSES


def confusion(pairs: Iterable[tuple[Image, Image]]) -> Array:
    """Numbers (7, 7) of pixels by true label (row) and label found (column), of pairs (found, true).

    Background counts away from the true labels only, whose masks are drawn a little too small.
    """
    total = np.zeros((CLASSES, CLASSES), np.int64)
    for found, truth in pairs:
        margin = 2 * (truth.shape[0] // 50) + 1
        near = cv2.dilate((truth > 0).astype(np.uint8), np.ones((margin, margin), np.uint8))
        use = (truth > 0) | (near == 0)
        codes = CLASSES * truth[use].astype(np.int64) + found[use]
        total += np.bincount(codes, minlength=CLASSES**2).reshape(CLASSES, CLASSES)
    return total
