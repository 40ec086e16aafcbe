import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.helpers import image_grid, look_at, make_camera, opencv_pixels
from tracker.calibration.files import read_calibrated
from tracker.errors import CalibrationError
from tracker.geometry.camera import Camera


def points_seen(camera: Camera, rng: np.random.Generator, pixels: np.ndarray) -> np.ndarray:
    depth = rng.uniform(0.2, 1.0, size=(len(pixels), 1))
    return camera.position + depth * camera.rays(pixels)


CAMERA = make_camera()
POINTS = points_seen(CAMERA, np.random.default_rng(0), image_grid(CAMERA, 5))


def test_a_camera_looks_along_its_z_axis_with_y_down():
    camera = dataclasses.replace(make_camera(), camera_from_world=look_at(np.array([0.5, 0, 0])))
    center, above, right = camera.project([[0, 0, 0], [0, 0, 0.01], [0, 0.01, 0]])
    np.testing.assert_allclose(center, camera.matrix[:2, 2])
    assert above[1] < center[1]
    assert right[0] > center[0]
    # Points behind it have no pixel.
    points = camera.position + np.outer([-0.1, 0.0, 0.1], camera.camera_from_world[2, :3])
    pixels, jacobian = camera.project_with_jacobian(points)
    assert np.isnan(pixels[:2]).all()
    assert np.isnan(jacobian[:2]).any(axis=(1, 2)).all()
    assert np.isfinite(pixels[2]).all()
    np.testing.assert_array_equal(camera.project(points), pixels)


def assert_undistorted(camera: Camera, least: float) -> None:
    """To the corners, of so large a share of the pixels."""
    pixels = image_grid(camera, 40)
    normalized = camera.undistort(pixels)
    found = np.isfinite(normalized).all(axis=1)
    assert found.mean() >= least
    on_plane = np.c_[normalized, np.ones(len(pixels))][found]
    np.testing.assert_allclose(opencv_pixels(camera, on_plane, np.eye(4)), pixels[found], atol=1e-9)


def test_undistort_inverts_the_distortion_and_says_so_where_no_ray_leads_to_a_pixel():
    assert_undistorted(CAMERA, 1.0)
    assert np.isnan(CAMERA.undistort([[5000.0, 5000.0]])).all()


def test_no_ray_is_beyond_the_fold_of_the_distortion_though_it_may_rise_again():
    lens = [-0.35, -0.02, 0, 0, 0.03]
    camera = dataclasses.replace(CAMERA, width=640, height=480, distortion=lens, camera_from_world=np.eye(4))
    tangents = np.linspace(0, 3, 30_001)
    bent = camera.project(np.c_[tangents, 0 * tangents, np.ones(len(tangents))])[:, 0]
    fold = np.argmax(np.diff(bent) < 0)
    assert bent[-1] > bent[fold]
    away = np.linspace(0.9, 3.0, 200) * (bent[fold] - bent[0])
    found = camera.undistort(np.c_[bent[0] + away, np.full(len(away), camera.matrix[1, 2])])[:, 0]
    expected = np.interp(bent[0] + away, bent[:fold], tangents[:fold], right=np.nan)
    np.testing.assert_allclose(found, expected, atol=1e-4)


def test_every_real_camera_projects_as_opencv_and_undistorts(real, rng):
    for file in [*real.glob("calibration/*/*.yml"), *real.glob("pose/*/*.yml")]:
        camera = read_calibrated(file).camera
        # Uncropped images reach, in a few pixels of a corner, beyond what the distortion can map to.
        assert_undistorted(camera, 0.998 if camera.width == 720 else 1.0)
        points = rng.uniform([-0.2, -0.2, 0], [0.2, 0.2, 0.15], size=(100, 3))
        np.testing.assert_allclose(camera.project(points), opencv_pixels(camera, points), atol=1e-9)


def test_rays_are_unit_and_project_to_their_pixels(rng):
    pixels = image_grid(CAMERA)
    np.testing.assert_allclose(np.linalg.norm(CAMERA.rays(pixels), axis=1), 1)
    np.testing.assert_allclose(CAMERA.project(points_seen(CAMERA, rng, pixels)), pixels, atol=1e-9)
    np.testing.assert_allclose(CAMERA.position, [0.175, 0.35 * np.sin(np.pi / 3), 0.37])
    np.testing.assert_allclose(CAMERA.world_from_camera @ CAMERA.camera_from_world, np.eye(4), atol=1e-15)


@given(st.integers(1, 2000), st.integers(1, 2000), st.integers(-100, 300), st.integers(-100, 300))
def test_resizing_and_cropping_commute_with_projection(width, height, left, top):
    scale = np.array([width / CAMERA.width, height / CAMERA.height])
    resized = CAMERA.resized(width, height)
    assert (resized.width, resized.height) == (width, height)
    expected = (CAMERA.project(POINTS) + 0.5) * scale - 0.5
    np.testing.assert_allclose(resized.project(POINTS), expected, atol=1e-8)
    cropped = CAMERA.cropped(left, top, 100, 80)
    assert (cropped.width, cropped.height) == (100, 80)
    np.testing.assert_allclose(cropped.project(POINTS), CAMERA.project(POINTS) - (left, top), atol=1e-9)


def test_arrays_are_copied_and_read_only():
    matrix = CAMERA.matrix.copy()
    copy = dataclasses.replace(CAMERA, matrix=matrix)
    matrix[0, 0] = 1
    assert copy.matrix[0, 0] == CAMERA.matrix[0, 0]
    with pytest.raises(ValueError, match="read-only"):
        copy.matrix[0, 0] = 1


def _changed(array: np.ndarray, index: tuple[int, ...], value: float) -> np.ndarray:
    out = np.array(array)
    out[index] = value
    return out


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("name", "", "name: found ''"),
        ("name", 60, "name: found 60"),
        ("width", 0, "width: found 0"),
        ("width", 270.0, "width: found 270.0"),
        ("width", True, "width: found True"),
        ("height", 10**6, "height: found 1000000"),
        pytest.param("width", 10**5000, "width: found a whole number above", id="width of 5000 digits"),
        pytest.param("name", 10**5000, "name: found a whole number above", id="name of 5000 digits"),
        pytest.param("matrix", [[10**400] * 3] * 3, "matrix: found list", id="focal length of 400 digits"),
        (
            "camera_from_world_std",
            np.full((4, 4), 1e300),
            r"found 1e\+300, expected standard deviations from 0 to",
        ),
        ("matrix", np.eye(4), r"matrix: found shape \(4, 4\)"),
        ("matrix", "text", "matrix: found str"),
        ("matrix", _changed(CAMERA.matrix, (0, 0), np.nan), "not finite"),
        ("matrix", _changed(CAMERA.matrix, (0, 0), 0), "focal lengths"),
        ("matrix", _changed(CAMERA.matrix, (1, 1), -3), "focal lengths"),
        ("matrix", _changed(CAMERA.matrix, (0, 1), 1), "skew"),
        ("matrix", _changed(CAMERA.matrix, (2, 2), 2), "last row"),
        ("matrix", _changed(CAMERA.matrix, (0, 0), 1e20), "focal lengths 1e"),
        ("matrix", _changed(CAMERA.matrix, (0, 2), 1e20), r"principal point 1e\+20.*expected at most 1e"),
        ("distortion", np.zeros(4), r"shape \(4,\)"),
        ("distortion", [0.0] * 8 + [1e19] + [0.0] * 3, r"found 1e\+19, expected coefficients of at most"),
        ("camera_from_world", _changed(CAMERA.camera_from_world, (2, 3), 1e20), r"1e\+20 m"),
        ("camera_from_world", _changed(CAMERA.camera_from_world, (3, 0), 1), "last row"),
        ("camera_from_world", _changed(CAMERA.camera_from_world, (0, 0), 2), "deviates from a rotation"),
        ("camera_from_world", np.diag([1.0, 1.0, -1.0, 1.0]), "by inf, .* axis inverted"),
        ("camera_from_world_std", -np.ones((4, 4)), "found -1, expected standard deviations from 0 to"),
        ("resized", ("a", 3), "width: found 'a'"),
        pytest.param("resized", (3, 10**400), "height: found a whole number above", id="large"),
        ("cropped", ("a", 0, 3, 3), "left and top: found tuple"),
        ("cropped", (1e300, 0, 3, 3), "principal point"),
        ("project", (np.zeros((3, 8)),), r"points: found shape \(3, 8\), expected .* \(N, 3\)"),
        ("project_in_view", (np.zeros((2, 6)),), r"points: found shape \(2, 6\)"),
        ("undistort", (np.zeros((2, 5)),), r"pixels: found shape \(2, 5\), expected .* \(N, 2\)"),
        ("rays", (np.zeros(4),), r"pixels: found shape \(4,\)"),
    ],
)
def test_impossible_parameters_parts_sizes_and_points_are_named(key, value, message):
    part = getattr(CAMERA, key)
    with pytest.raises(CalibrationError, match=message):
        part(*value) if callable(part) else dataclasses.replace(CAMERA, **{key: value})
