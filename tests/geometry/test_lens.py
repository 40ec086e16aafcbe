from __future__ import annotations

import dataclasses

import cv2
import numpy as np
import pytest

from tests.helpers import LENSES, make_camera, numerical_jacobian, random_rotations
from tracker.geometry import lens, so3
from tracker.geometry.cuboid import visible_faces as visible_faces_reference
from tracker.geometry.lens import stack_lenses


def test_compiled_projection_is_the_cameras(rng):
    cameras = [make_camera(a) for a in (60.0, 180.0, 300.0)]
    lenses = stack_lenses(cameras)
    points = rng.uniform([-0.2, -0.2, 0], [0.2, 0.2, 0.15], size=(100, 3))
    for c, camera in enumerate(cameras):
        pixels = [lens.project(lenses, c, *point)[:2] for point in points]
        np.testing.assert_allclose(pixels, camera.project(points), atol=1e-9)


def test_compiled_jacobian_is_the_derivative(rng):
    lenses = stack_lenses([make_camera()])
    jacobian = np.empty((2, 3))
    for point in rng.uniform([-0.2, -0.2, 0], [0.2, 0.2, 0.15], size=(20, 3)):
        lens.project_with_jacobian(lenses, 0, *point, jacobian)
        numeric = numerical_jacobian(lambda x: np.array(lens.project(lenses, 0, *x)[:2]), point)
        np.testing.assert_allclose(jacobian, numeric, rtol=1e-5, atol=1e-4)


@pytest.mark.parametrize("coefficients", LENSES.values(), ids=map(str, LENSES))
def test_every_lens_of_opencv_is_projected_by_camera_and_compiled_code(coefficients, rng):
    camera = dataclasses.replace(make_camera(), distortion=np.array(coefficients))
    lenses, jacobian = stack_lenses([camera]), np.empty((2, 3))
    points = rng.uniform([-0.18, -0.18, 0], [0.18, 0.18, 0.15], size=(40, 3))
    turn, _ = cv2.Rodrigues(np.array(camera.camera_from_world[:3, :3]))
    move = np.array(camera.camera_from_world[:3, 3])
    expected, slopes = cv2.projectPoints(points, turn, move, np.array(camera.matrix), np.array(coefficients))
    # Derivatives by the translation in the camera's frame, which turning takes to those by the point.
    slopes = slopes[:, 3:6].reshape(-1, 2, 3) @ camera.camera_from_world[:3, :3]
    pixels, derivatives = camera.project_with_jacobian(points)
    np.testing.assert_allclose(pixels, expected[:, 0], atol=1e-9)
    np.testing.assert_allclose(derivatives, slopes, rtol=1e-8, atol=1e-7)
    for point, pixel, slope in zip(points, expected[:, 0], slopes, strict=True):
        np.testing.assert_allclose(lens.project(lenses, 0, *point)[:2], pixel, atol=1e-9)
        found = lens.project_with_jacobian(lenses, 0, *point, jacobian)[:2]
        np.testing.assert_allclose(found, pixel, atol=1e-9)
        np.testing.assert_allclose(jacobian, slope, rtol=1e-8, atol=1e-7)
    on_image = rng.uniform(0, 269, size=(60, 2))
    ahead = camera.position + 0.5 * camera.rays(on_image)
    np.testing.assert_allclose(camera.project(ahead), on_image, atol=1e-8)


def test_update_perturbs_on_the_left(rng):
    rotation, position = random_rotations(rng, 1)[0], rng.normal(size=3)
    update = rng.normal(size=6)
    moved_rotation, moved_position = rotation.copy(), position.copy()
    lens.apply_update(moved_rotation, moved_position, update)
    np.testing.assert_allclose(moved_rotation, so3.exp(update[3:]) @ rotation, atol=1e-12)
    np.testing.assert_allclose(moved_position, position + update[:3])


def test_visible_faces_are_those_of_the_geometry(rng):
    camera = make_camera()
    lenses, size = stack_lenses([camera]), np.array([0.02, 0.08, 0.03])
    for rotation in random_rotations(rng, 30):
        position, heights = rng.uniform(-0.1, 0.1, 3), np.empty(6)
        lens.visible_faces(lenses, 0, size / 2, rotation, position, heights)
        expected = visible_faces_reference(size, rotation.T @ (camera.position - position))
        np.testing.assert_array_equal(heights > 0, expected)
