"""How large the object is in each picture: lengths in pixels are stated for an object of reference size."""

from __future__ import annotations

import math

import numpy as np

from tracker.conventions import Array, FloatArray
from tracker.objects.box import Box

REFERENCE = 55.0
"""Size in the picture [px] at which lengths are stated: a little more than
that of the platform's objects at 270×270."""

LEAST = 0.6
"""Least size over the reference: below it, strips would have too few pixels."""

SEARCH_SIZE = 135
"""Shorter side [px] of the label maps in which the object is searched and aligned."""


def extent(box: Box) -> float:
    """One length [m] for a box's size: between its longest edge, which tells its rotation, and its diagonal.

    Their geometric mean is the same, to 4 %, for a cube of 65 mm and a cuboid of 20 × 20 × 80 mm, which the
    refinement's lengths suit alike.
    """
    return math.sqrt(2.0 * float(box.half.max()) * 2.0 * box.radius)


def relative_sizes(lenses: Array, box: Box, position: FloatArray) -> FloatArray:
    """(C,) sizes of the object at a position (3,) [m] in the pictures of lenses (C,), over the reference."""
    depth = lenses["rotation"][:, 2] @ position + lenses["translation"][:, 2]
    focal = np.sqrt(lenses["focal"][:, 0] * lenses["focal"][:, 1])
    size = extent(box)
    sizes: FloatArray = focal * size / np.maximum(depth, size) / REFERENCE
    return np.asarray(np.maximum(sizes, LEAST))


def reduced_size(width: int, height: int, shorter: int = SEARCH_SIZE) -> tuple[int, int]:
    """Size of an image reduced by a whole factor so that its shorter side comes nearest to `shorter`."""
    factor = max(1, round(min(width, height) / shorter))
    return width // factor, height // factor
