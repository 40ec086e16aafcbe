from __future__ import annotations

import numpy as np

from tests.helpers import make_camera, numerical_jacobian, random_rotations
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
