"""How a picture looks, whatever it shows: too dark, too bright or blurred."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from tracker.calibration.board.sighting import photo_blur
from tracker.calibration.by_object.health import LEVELS, MOST_CLIPPED, brightness, clipped_share
from tracker.conventions import Image

MOST_BLUR = 2.5
"""Standard deviation of the sharpest edges' blur [px]."""


class PictureLook(NamedTuple):
    """Exposure and sharpness of a picture, or their medians over several."""

    level: float
    """Median grey level."""
    clipped: float
    """Pixels with a clipped channel [%]."""
    blur: float
    """Of its strongest edges [px]; NaN where it shows none."""

    @classmethod
    def of(cls, image: Image) -> PictureLook:
        """Look at a picture (H, W, 3), which takes some milliseconds."""
        grey = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)
        return cls(brightness(image), 100 * clipped_share(image), photo_blur(grey))

    def faults(self) -> list[str]:
        """What is wrong, and what may help."""
        found = []
        if self.level < LEVELS[0]:
            found.append(f"dark, median grey level {self.level:.0f}: expose longer, or is the lens covered?")
        if self.level > LEVELS[1] or self.clipped > 100 * MOST_CLIPPED:
            found.append(
                f"over-exposed, median grey level {self.level:.0f}, {self.clipped:.0f} % of its pixels are "
                "clipped: expose for less long"
            )
        if self.blur > MOST_BLUR:
            found.append(f"blurred by {self.blur:.1f} px: focus, or does the camera shake?")
        return found
