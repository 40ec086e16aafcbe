"""What tests of drawings share: cameras, and black pictures of them."""

import numpy as np
import pytest

from tests.helpers import make_rig
from tracker.calibration.rig import CameraRig


@pytest.fixture
def rig() -> CameraRig:
    return make_rig()


def black(rig: CameraRig) -> list[np.ndarray]:
    return [np.zeros((camera.height, camera.width, 3), np.uint8) for camera in rig]
