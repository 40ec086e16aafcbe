"""Light whose colour changes over a picture, and how much of its labels is left."""

import numpy as np


def ramp(image, blue, red):
    """The image in light that has so much more blue at its right border than in the middle, and red below."""
    height, width = image.shape[:2]
    x, y = np.linspace(-1.0, 1.0, width), np.linspace(-1.0, 1.0, height)
    factors = np.ones((height, width, 3))
    factors[..., 0] += blue * x
    factors[..., 2] += red * y[:, None]
    return np.clip(np.rint(image * factors), 0, 255).astype(np.uint8)


def overlap(found, true):
    """Intersection over union of the pixels that show the right face."""
    return np.count_nonzero((found == true) & (true > 0)) / np.count_nonzero((found > 0) | (true > 0))
