from __future__ import annotations

import dataclasses
import json

import cv2
import numpy as np
import pytest

import tracker
from synthetic.camera.sensor import Sensor
from tests.helpers.stills import bare_scene, take
from tracker.geometry import so3

SCENES = 6


@pytest.fixture(scope="module")
def pictures(rig, tmp_path_factory):
    """Folder of two calibrations, the right one and one with camera180 knocked, and files of pictures."""
    folder = tmp_path_factory.mktemp("check")
    files = []
    for k in range(SCENES):
        rng = np.random.default_rng([71, k])
        still = take(bare_scene(tracker.load_object("cube_v2"), rng), rig.cameras, Sensor.realistic(), rng)
        for camera, image in zip(rig, still.images, strict=True):
            files.append(folder / f"{k}-{camera.name}.png")
            cv2.imwrite(str(files[-1]), image)
    transform = rig[1].camera_from_world.copy()
    transform[:3] = so3.exp([0.012, -0.009, 0.0]) @ transform[:3]
    knocked = dataclasses.replace(rig[1], camera_from_world=transform)
    rig.save(folder / "right")
    dataclasses.replace(rig, cameras=(rig[0], knocked, rig[2])).save(folder / "wrong")
    return folder, files


def test_a_right_calibration_fits(pictures, run_here):
    folder, files = pictures
    result = run_here("calibrate", "check", *files, "--object", "cube_v2", "--calibration", folder / "right")
    assert result.returncode == 0, result.stderr
    assert "the calibration fits" in result.stdout


def test_a_camera_that_was_knocked_is_named_and_drawn(pictures, run_here, tmp_path):
    folder, files = pictures
    result = run_here(
        "calibrate", "check", *files, "--object", "cube_v2", "--calibration", folder / "wrong", "--json",
        "-o", tmp_path / "check.png",
    )  # fmt: skip
    assert result.returncode == 1, result.stderr
    found = json.loads(result.stdout)
    assert not found["fits"]
    assert [one["moved"] for one in found["cameras"]] == [False, True, False]
    assert found["cameras"][1]["turn_deg"] == pytest.approx(np.degrees(0.015), abs=0.15)
    picture = cv2.imread(str(tmp_path / "check.png"))
    assert picture.shape[1] == 3 * picture.shape[0] * 420 // 496
    told = run_here("calibrate", "check", *files, "--object", "cube_v2", "--calibration", folder / "wrong")
    assert "does not fit: camera180 is not where it has it" in told.stdout


def test_one_camera_is_refused(pictures, run_here):
    folder, files = pictures
    one = folder / "right" / "camera60.yml"
    result = run_here("calibrate", "check", files[0], "--object", "cube_v2", "--calibration", one)
    assert result.returncode == 2
    assert "alone" in result.stderr
