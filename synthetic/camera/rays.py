"""The rays that a calibrated camera's pixels see along, by OpenCV's inverse of the lens."""

from __future__ import annotations

import cv2
import numpy as np

from tracker.conventions import Array, FloatArray
from tracker.errors import CalibrationError

_TOLERANCE_PX = 1e-6


def rays_of(name: str, pixels: Array, matrix: Array, distortion: Array) -> FloatArray:
    """Normalised coordinates (N, 2) that the camera `name` shows at pixels (N, 2), iterated to convergence.

    matrix (3, 3) and distortion (5,) to (14,) as of `Camera`.

    Raises:
        CalibrationError: the lens has no inverse at some of them.
    """
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 500, 1e-11)
    if hasattr(cv2, "undistortPointsIter"):  # until OpenCV 5, undistortPoints takes no criteria
        rays = cv2.undistortPointsIter(pixels[:, None], matrix, distortion, np.eye(3), np.eye(3), criteria)
    else:
        rays = cv2.undistortPoints(pixels[:, None], matrix, distortion, criteria=criteria)
    result: FloatArray = rays.reshape(-1, 2)
    error = np.abs(seen_at(result, matrix, distortion) - pixels).max()
    if not error < _TOLERANCE_PX:
        raise CalibrationError(
            f"{name}: the lens has no inverse all over the image: found a residual of {error:.2g} px, "
            f"expected less than {_TOLERANCE_PX:g}"
        )
    return result


def seen_at(rays: Array, matrix: Array, distortion: Array) -> FloatArray:
    """Pixels (N, 2) of rays (N, 2): OpenCV's model, without the derivatives that `projectPoints` adds."""
    if len(distortion) > 5:  # rare enough for them
        ahead = np.insert(rays, 2, 1.0, axis=1)
        pixels, _ = cv2.projectPoints(ahead, np.zeros(3), np.zeros(3), matrix, distortion)
        return np.asarray(pixels.reshape(-1, 2), np.float64)
    x, y = rays[:, 0], rays[:, 1]
    k1, k2, p1, p2, k3 = distortion
    squared = x * x + y * y
    radial = 1.0 + squared * (k1 + squared * (k2 + squared * k3))
    twice = 2.0 * x * y
    bent_x = x * radial + p1 * twice + p2 * (squared + 2.0 * x * x)
    bent_y = y * radial + p1 * (squared + 2.0 * y * y) + p2 * twice
    return np.stack([matrix[0, 0] * bent_x + matrix[0, 2], matrix[1, 1] * bent_y + matrix[1, 2]], axis=1)
