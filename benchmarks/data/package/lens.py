"""Pictures without distortion, bent as a camera's lens bends them."""

from __future__ import annotations

import functools

import cv2
import numpy as np

from tracker.conventions import Array, FloatArray
from tracker.errors import CalibrationError
from tracker.geometry.camera import Camera

_TOLERANCE_PX = 1e-6
"""By which the lens and its inverse may disagree [px]."""


@functools.lru_cache(maxsize=8)
def normalised(camera: Camera) -> FloatArray:
    """(H, W, 2) normalised coordinates X/Z, Y/Z of the rays through the centres of a camera's pixels.

    By OpenCV's inverse of the lens, iterated to convergence: pictures share no projection with the tracker.

    Raises:
        CalibrationError: the lens has no inverse all over the image.
    """
    columns, rows = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    pixels = np.stack([columns, rows], axis=-1).reshape(-1, 1, 2).astype(np.float64)
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 500, 1e-11)
    if hasattr(cv2, "undistortPointsIter"):  # until OpenCV 5, undistortPoints takes no criteria
        result = cv2.undistortPointsIter(
            pixels, camera.matrix, camera.distortion, np.eye(3), np.eye(3), criteria
        )
    else:
        result = cv2.undistortPoints(pixels, camera.matrix, camera.distortion, criteria=criteria)
    points = np.asarray(result, dtype=np.float64).reshape(-1, 2)
    back, _ = cv2.projectPoints(
        np.insert(points, 2, 1.0, axis=1), np.zeros(3), np.zeros(3), camera.matrix, camera.distortion
    )
    error = float(np.abs(back - pixels).max())
    if not error < _TOLERANCE_PX:
        raise CalibrationError(
            f"{camera.name}: the lens has no inverse all over the image: found a residual of {error:.2g} px, "
            f"expected less than {_TOLERANCE_PX:g}"
        )
    points.flags.writeable = False
    return points.reshape(camera.height, camera.width, 2)


def bend_map(camera: Camera, margin: int) -> Array:
    """(H, W, 2) float32: where the rays of a camera's pixels meet a picture that it took without distortion.

    Args:
        camera: with its distortion.
        margin: by which that picture is wider than the camera's own on each side [px].

    Raises:
        CalibrationError: the lens has no inverse all over the image, or shows more than the margin holds.
    """
    places = normalised(camera) * camera.matrix[(0, 1), (0, 1)] + camera.matrix[:2, 2] + margin
    last = np.array([camera.width, camera.height]) + 2 * margin - 1
    beyond = float(max(-places.min(), (places - last).max()))
    if beyond > 0:
        raise CalibrationError(
            f"{camera.name}: its lens shows {margin + beyond:.1f} px more than the image, expected at most "
            f"the margin of {margin} px"
        )
    return places.astype(np.float32)


def bent(picture: Array, places: Array) -> Array:
    """A picture without distortion (H', W', ...), bilinear at `places` (H, W, 2) [px]; of its own type."""
    return np.asarray(cv2.remap(picture, places[..., 0], places[..., 1], cv2.INTER_LINEAR))
