"""What tests of drawings share: cameras, and black pictures of them."""

import numpy as np
import pytest

from tests.helpers import make_camera
from tracker.calibration.rig import CameraRig


@pytest.fixture
def rig() -> CameraRig:
    return CameraRig(tuple(make_camera(azimuth) for azimuth in (60, 180, 300)))


def black(rig: CameraRig) -> list[np.ndarray]:
    return [np.zeros((camera.height, camera.width, 3), np.uint8) for camera in rig]
