import dataclasses

import numpy as np
import pytest

from scripts.fit_rigs import NAMES, figures
from synthetic.camera import rigs
from synthetic.camera.lens import Lens, seen_at
from synthetic.camera.rigs import ROBOTS, choose_rig, default_cameras
from tests.helpers import opencv_pixels
from tracker.errors import CalibrationError
from tracker.geometry import so3


@pytest.mark.parametrize("seed", range(8))
def test_a_random_rig_sees_the_arena_from_three_sides_through_lenses_that_have_an_inverse(seed):
    rig = choose_rig("random", seed).resized(270, 270)
    assert rig.names == ("camera60", "camera180", "camera300")
    angles = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    floor = np.column_stack([0.12 * np.cos(angles), 0.12 * np.sin(angles), np.zeros(24)])
    for camera in rig:
        Lens(camera, 1)
        assert camera.project(floor).min() > 0
        assert camera.project(floor).max() < 269
        assert 0.45 < np.linalg.norm(camera.position) < 0.66
        assert camera.camera_from_world[1, 2] < 0  # upright: the world's up is up in the picture
    azimuths = np.sort([np.arctan2(*camera.position[1::-1]) for camera in rig])
    assert np.diff(azimuths, append=azimuths[0] + 2 * np.pi).min() > np.radians(60)
    same, other = (choose_rig("random", one)[0].camera_from_world for one in (seed, seed + 1))
    assert np.array_equal(same, rig[0].camera_from_world)
    assert not np.array_equal(same, other)


def test_rays_are_seen_where_opencv_projects_them_and_a_lens_that_folds_the_picture_is_refused(rng):
    rays = rng.uniform(-0.5, 0.5, (50, 2))
    for camera in choose_rig("random", 3):
        pixels = opencv_pixels(camera, np.insert(rays, 2, 1.0, axis=1), np.eye(4))
        found = seen_at(rays, camera.matrix, camera.distortion)
        np.testing.assert_allclose(found, pixels, rtol=0, atol=1e-9)
    camera = default_cameras()[0]
    folding = dataclasses.replace(camera, distortion=np.array([-1.5, 0.0, 0.0, 0.0, 0.0]))
    with pytest.raises(CalibrationError, match="camera60: the lens has no inverse"):
        Lens(folding, 1)


@pytest.mark.parametrize("name", ROBOTS)
def test_a_robots_name_is_its_recorded_calibration(name, real):
    rig = choose_rig(name, 0)
    assert rig.names == ("camera60", "camera180", "camera300")
    assert all(camera.height == 270 for camera in rig)


def test_how_far_a_camera_is_rolled_is_measured_about_its_axis():
    for camera in default_cameras():
        roll = so3.transform(so3.exp([0.0, 0.0, np.radians(3.0)]), [0.0, 0.0, 0.0])
        rolled = dataclasses.replace(camera, camera_from_world=roll @ camera.camera_from_world)
        found = dict(zip(NAMES, figures(rolled), strict=True))
        assert found["roll about its axis [deg]"] == pytest.approx(3.0)


def test_a_name_that_is_none_is_distinguished_from_a_robot_whose_files_are_missing(monkeypatch, tmp_path):
    with pytest.raises(CalibrationError, match="found no such folder, expected one, or one of simulation"):
        choose_rig("r2", 0)
    monkeypatch.setattr(rigs, "RECORDED", tmp_path)
    with pytest.raises(CalibrationError, match="calibration r1: found no folder"):
        choose_rig("r1", 0)
