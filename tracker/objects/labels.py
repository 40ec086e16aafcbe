"""Labels of the colours that a pixel or a face can have."""

import numpy as np

from tracker.conventions import Image

COLOR_NAMES = ("background", "red", "green", "blue", "cyan", "magenta", "yellow")
"""Names of the colours, indexed by label."""

UNKNOWN = 255
"""Label of pixels to ignore, since they are known to show a finger."""

DISPLAY_COLORS_BGR: Image = np.array(
    [[0, 0, 0], [0, 0, 255], [0, 255, 0], [255, 0, 0], [255, 255, 0], [255, 0, 255], [0, 255, 255]],
    dtype=np.uint8,
)
"""(7, 3) BGR colours in which labels are drawn; `DISPLAY_COLORS_BGR[labels]` is an image."""
DISPLAY_COLORS_BGR.flags.writeable = False
