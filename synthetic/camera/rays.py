"""The rays that a calibrated camera's pixels see along, by OpenCV's inverse of the lens."""

from __future__ import annotations

import cv2
import numpy as np

from tracker.conventions import Array, FloatArray
from tracker.errors import CalibrationError

_TOLERANCE_PX = 1e-6


def rays_of(name: str, pixels: Array, matrix: Array, distortion: Array) -> FloatArray:
    """Normalised coordinates (N, 2) that the camera `name` shows at pixels (N, 2), iterated to convergence.

    matrix (3, 3) and distortion (5,) as of `Camera`.

    Raises:
        CalibrationError: the lens has no inverse at some of them.
    """
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 500, 1e-11)
    if hasattr(cv2, "undistortPointsIter"):  # until OpenCV 5, undistortPoints takes no criteria
        rays = cv2.undistortPointsIter(pixels[:, None], matrix, distortion, np.eye(3), np.eye(3), criteria)
    else:
        rays = cv2.undistortPoints(pixels[:, None], matrix, distortion, criteria=criteria)
    result: FloatArray = rays.reshape(-1, 2)
    ahead = np.insert(result, 2, 1.0, axis=1)
    back, _ = cv2.projectPoints(ahead, np.zeros(3), np.zeros(3), matrix, distortion)
    error = np.abs(back.reshape(-1, 2) - pixels).max()
    if not error < _TOLERANCE_PX:
        raise CalibrationError(
            f"{name}: the lens has no inverse all over the image: found a residual of {error:.2g} px, "
            f"expected less than {_TOLERANCE_PX:g}"
        )
    return result
