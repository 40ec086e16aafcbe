from __future__ import annotations

import numpy as np
import pytest

from tracker.calibration.rig import CameraRig
from tracker.errors import CalibrationError

NAMES = ("camera60", "camera180", "camera300")


@pytest.mark.parametrize("name", ["cube_v1", "cube_v2", "cuboid_2x2x8_v2"])
def test_a_recordings_folder_loads_as_it_is(name, real):
    assert CameraRig.load(real / "pose" / name).names == NAMES


@pytest.mark.parametrize("robot", [1, 3, 4, 5, 6, 7, 8])
def test_cameras_of_every_robot_look_at_the_arena_from_half_a_metre(robot, real):
    rig = CameraRig.load(real / "calibration" / "robots", pattern=f"r{robot}_*.yml")
    assert rig.names == NAMES
    for camera in rig:
        assert 0.4 < np.linalg.norm(camera.position) < 0.6
        assert camera.position[2] > 0.3
        (pixel,) = camera.project([[0.0, 0.0, 0.0]])
        assert (np.abs(pixel - camera.width / 2) < 30).all()


@pytest.mark.parametrize("folder", ["simulation", "robots"])
def test_a_folder_of_several_variants_asks_for_one(folder, real):
    with pytest.raises(CalibrationError, match="select with"):
        CameraRig.load(real / "calibration" / folder)


def test_the_platforms_halved_files_agree_with_the_resized_ones_once_corrected(real):
    folder = real / "calibration" / "simulation"
    expected = CameraRig.load(folder, pattern="*_cropped.yml").resized(270, 270)
    halved = CameraRig.load(
        folder, pattern="*_cropped_and_downsampled.yml", correct_halved_principal_point=True
    )
    for first, second in zip(expected, halved, strict=True):
        np.testing.assert_allclose(first.matrix, second.matrix, rtol=1e-12)


def test_cropping_the_full_camera_gives_the_cropped_one(real):
    folder = real / "calibration" / "simulation"
    full = CameraRig.load(folder, pattern="*_full.yml")
    cropped = CameraRig.load(folder, pattern="*_cropped.yml")
    for first, second in zip(full, cropped, strict=True):
        np.testing.assert_allclose(first.cropped(88, 0, 540, 540).matrix, second.matrix, atol=1e-9)
