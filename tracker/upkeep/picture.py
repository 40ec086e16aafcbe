"""How bright a picture is, whatever it shows: one measure for cameras that run and for recordings."""

from __future__ import annotations

import cv2
import numpy as np

from tracker.conventions import Image
from tracker.segmentation.light import CLIPPED

LEVELS = (30.0, 200.0)
"""Between which a picture's brightness should be; recordings of the platform have 80 to 125."""


def brightness(image: Image) -> float:
    """Median grey level of a picture (H, W, 3); a lamp in view or a dark finger hardly changes it."""
    return float(np.median(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)))


def clipped_share(image: Image) -> float:
    """Share of the pixels of a picture (H, W, 3) with a channel that is clipped."""
    return float((image.max(axis=2) >= CLIPPED).mean())
