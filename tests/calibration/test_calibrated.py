"""Calibration files with the deviations of all parameters."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tracker.calibration.calibrated import (
    Calibrated,
    read_all_calibrated,
    read_calibrated,
    write_calibrated,
)
from tracker.calibration.platform_files import read_camera
from tracker.errors import CalibrationError

MATRIX_STD = np.array([[0.5, 0, 1.2], [0, 0.6, 1.1], [0, 0, 0]])
DISTORTION_STD = np.array([0.01, 0.05, 4e-4, 3e-4, 0.1])


@pytest.fixture
def calibrated(camera):
    return Calibrated(camera, MATRIX_STD, DISTORTION_STD)


def assert_same(first, second):
    for key in ("matrix", "distortion", "camera_from_world", "camera_from_world_std"):
        assert np.array_equal(getattr(first.camera, key), getattr(second.camera, key))
    assert np.array_equal(first.matrix_std, second.matrix_std)
    assert np.array_equal(first.distortion_std, second.distortion_std)
    assert first.placed == second.placed


def test_a_file_is_read_as_it_was_written_and_as_the_platforms(calibrated, tmp_path):
    write_calibrated(calibrated, tmp_path / "camera60.yml")
    assert_same(read_calibrated(tmp_path / "camera60.yml"), calibrated)
    plain = read_camera(tmp_path / "camera60.yml")
    assert np.array_equal(plain.matrix, calibrated.camera.matrix)


def test_a_lens_alone_is_no_camera_yet(calibrated, tmp_path):
    lens = dataclasses.replace(
        calibrated, camera=dataclasses.replace(calibrated.camera, camera_from_world=np.eye(4)), placed=False
    )
    lens = dataclasses.replace(lens, camera=dataclasses.replace(lens.camera, camera_from_world_std=None))
    write_calibrated(lens, tmp_path / "lens.yml")
    read = read_calibrated(tmp_path / "lens.yml")
    assert not read.placed
    assert np.array_equal(read.camera.matrix, lens.camera.matrix)
    with pytest.raises(CalibrationError, match=r"tf_world_to_camera is missing.* calibrate extrinsics"):
        read_camera(tmp_path / "lens.yml")


def test_a_halved_camera_sees_the_halved_picture(calibrated):
    half = calibrated.resized(calibrated.camera.width // 2, calibrated.camera.height // 2)
    points = np.random.default_rng(3).uniform(-0.1, 0.1, (20, 3))
    # The pixel (i, j) of a halved picture is in the middle of four.
    assert half.camera.project(points) == pytest.approx((calibrated.camera.project(points) - 0.5) / 2)
    assert half.matrix_std == pytest.approx(MATRIX_STD / 2)


def test_a_cropped_camera_sees_the_cropped_picture(calibrated):
    part = calibrated.cropped(30, 20, 200, 150)
    points = np.random.default_rng(4).uniform(-0.1, 0.1, (20, 3))
    assert part.camera.project(points) == pytest.approx(calibrated.camera.project(points) - (30, 20))
    assert (part.camera.width, part.camera.height) == (200, 150)


def test_a_part_outside_of_the_picture_is_refused(calibrated):
    with pytest.raises(CalibrationError, match=r"200x150\+100\+20.* inside of 270x270"):
        calibrated.cropped(100, 20, 200, 150)


def test_all_files_of_a_folder_come_in_the_cameras_order(calibrated, tmp_path):
    for name in ("camera300", "camera60", "camera180"):
        one = dataclasses.replace(calibrated, camera=dataclasses.replace(calibrated.camera, name=name))
        write_calibrated(one, tmp_path / f"{name}.yml")
    names = [one.camera.name for one in read_all_calibrated([tmp_path])]
    assert names == ["camera60", "camera180", "camera300"]
    listed = read_all_calibrated([tmp_path / "camera300.yml", tmp_path / "camera60.yml"])
    assert [one.camera.name for one in listed] == ["camera300", "camera60"]
    write_calibrated(calibrated, tmp_path / "camera60_cropped.yml")
    with pytest.raises(CalibrationError, match="expected one of each camera"):
        read_all_calibrated([tmp_path])
