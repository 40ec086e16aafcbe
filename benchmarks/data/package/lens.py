"""Distortion of undistorted images by a camera's lens."""

from __future__ import annotations

import functools

import cv2
import numpy as np

from synthetic.camera.lens import rays_of
from tracker.conventions import Array, FloatArray
from tracker.errors import CalibrationError
from tracker.geometry.camera import Camera


@functools.lru_cache(maxsize=8)
def normalised(camera: Camera) -> FloatArray:
    """Return normalised coordinates X/Z, Y/Z (H, W, 2) of the rays through a camera's pixel centres.

    Uses OpenCV's inverse of the lens model, iterated to convergence, not the tracker's own projection.

    Raises:
        CalibrationError: the lens model cannot be inverted everywhere in the image.
    """
    columns, rows = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    pixels = np.stack([columns, rows], axis=-1).reshape(-1, 2).astype(np.float64)
    points = rays_of(camera.name, pixels, camera.matrix, camera.distortion)
    points.flags.writeable = False
    return points.reshape(camera.height, camera.width, 2)


def bend_map(camera: Camera, margin: int) -> Array:
    """Return (H, W, 2) float32: where the rays of a camera's pixels meet an undistorted image [px].

    Args:
        camera: camera with its distortion.
        margin: width by which that image extends beyond the camera's own on each side [px].

    Raises:
        CalibrationError: the lens model cannot be inverted everywhere, or the margin is too small.
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
    """Sample an undistorted image (H', W', ...) bilinearly at `places` (H, W, 2) [px]; keeps its type."""
    return np.asarray(cv2.remap(picture, places[..., 0], places[..., 1], cv2.INTER_LINEAR))
