"""Units, frames and orders that hold everywhere in this package.

Units: metres, radians, seconds. Names of angles in degrees and of lengths in millimetres include the unit.

Frames: `a_from_b` is the transform from coordinates in frame b to coordinates in frame a.
    world   z up, origin at the arena's centre.
    camera  OpenCV: x to the right, y down, z forward. `camera_from_world` is what the platform's
            files call `tf_world_to_camera`: p_camera = camera_from_world · p_world.
    object  origin at the object's centre, axes along its edges.

Pixels: (column, row); the centre of the pixel in column i and row j is at (i, j).
Images: uint8, (height, width, 3), blue-green-red, as OpenCV reads them.
Cameras: in the order in which the rig lists them; on the TriFinger platform 60, 180, 300.

Quaternions: (x, y, z, w). Rotations are perturbed on the left, along world axes:
    p = p̂ + δp,  R = exp(δθ) R̂;  covariances are 6×6 of (δp, δθ) [m, rad].

Labels: 0 background, 1 red, 2 green, 3 blue, 4 cyan, 5 magenta, 6 yellow.
"""

from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]
"""Any NumPy array; docstrings state shape and unit."""

FloatArray = npt.NDArray[np.float64]
"""A double precision array."""

Image = npt.NDArray[np.uint8]
"""An image or a label map."""
