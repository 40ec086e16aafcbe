"""What tests of drawings share: cameras, black pictures of them, and OpenCV's own projection."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from tests.helpers import make_camera
from tracker.calibration.rig import CameraRig


@pytest.fixture
def rig() -> CameraRig:
    return CameraRig(tuple(make_camera(azimuth) for azimuth in (60, 180, 300)))


def black(rig: CameraRig) -> list[np.ndarray]:
    return [np.zeros((camera.height, camera.width, 3), np.uint8) for camera in rig]


def opencv_pixels(camera, points) -> np.ndarray:
    """Pixels (N, 2) by OpenCV's own camera."""
    rotation, _ = cv2.Rodrigues(camera.camera_from_world[:3, :3])
    shift = camera.camera_from_world[:3, 3]
    pixels, _ = cv2.projectPoints(np.asarray(points), rotation, shift, camera.matrix, camera.distortion)
    return pixels.reshape(-1, 2)
