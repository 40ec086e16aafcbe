from __future__ import annotations

import dataclasses

import numpy as np

from tests.helpers import make_camera, random_rotations
from tracker.geometry import so3
from tracker.pose import covariance


def spd(rng: np.random.Generator, scale: float = 1.0) -> np.ndarray:
    root = rng.normal(size=(6, 6))
    return scale * (root @ root.T + 0.5 * np.eye(6))


def test_element_wise_std_gives_back_the_rotation_vectors(rng):
    for rotation in random_rotations(rng, 5):
        variances = rng.uniform(0.5, 2.0, 3) * 1e-6
        design = [(so3.hat(axis) @ rotation) ** 2 for axis in np.eye(3)]
        std = np.sqrt(np.tensordot(variances, design, axes=1))
        np.testing.assert_allclose(
            covariance.rotation_vector_variance(rotation, std), variances, rtol=1e-6, atol=1e-12
        )


def test_camera_offset_is_what_samples_of_the_calibration_show(rng):
    camera, position = make_camera(), np.array([0.05, -0.08, 0.03])
    stated = covariance.offset_covariance(covariance.calibration_covariance(camera), position)
    assert camera.camera_from_world_std is not None
    rotation, translation = camera.camera_from_world[:3, :3], camera.camera_from_world[:3, 3]
    variances = covariance.rotation_vector_variance(rotation, camera.camera_from_world_std[:3, :3])
    errors = []
    for _ in range(4000):
        turn = so3.exp(rng.normal(size=3) * np.sqrt(variances))
        shift = rng.normal(size=3) * camera.camera_from_world_std[:3, 3]
        # Where a true camera sees the object, and which offset explains that with the stated camera.
        seen = turn @ rotation @ position + translation + shift
        moved = rotation.T @ (seen - translation) - position
        errors.append(np.concatenate([moved, so3.log(rotation.T @ turn @ rotation)]))
    np.testing.assert_allclose(np.cov(np.array(errors).T), stated, rtol=0.1, atol=0.06 * stated.max())


def test_step_is_that_of_the_dense_system(rng):
    cameras = 3
    information = np.array([spd(rng) for _ in range(cameras)])
    gradient, offsets = rng.normal(size=(cameras, 6)), rng.normal(size=(cameras, 6))
    weights = np.array([spd(rng, 0.5) for _ in range(cameras)])
    size = 6 * (1 + cameras)
    matrix, vector = np.zeros((size, size)), np.zeros(size)
    matrix[:6, :6] = np.diag(covariance.PRIOR) + information.sum(axis=0)
    vector[:6] = gradient.sum(axis=0)
    for c in range(cameras):
        block = slice(6 + 6 * c, 12 + 6 * c)
        matrix[:6, block], matrix[block, :6] = information[c], information[c]
        matrix[block, block] = information[c] + weights[c]
        vector[block] = gradient[c] - weights[c] @ offsets[c]
    expected = np.linalg.solve(matrix, vector)
    step = covariance.solve_step(information, gradient, offsets, weights)
    assert step is not None
    np.testing.assert_allclose(step.pose, expected[:6], atol=1e-9)
    np.testing.assert_allclose(step.offsets.ravel(), expected[6:], atol=1e-9)
    np.testing.assert_allclose(np.linalg.inv(step.information), np.linalg.inv(matrix)[:6, :6], atol=1e-9)


def test_covariance_grows_when_a_camera_is_covered(rng):
    information = np.array([spd(rng, 1e6) for _ in range(3)])
    weights = np.array([spd(rng, 1e6) for _ in range(3)])
    zeros = np.zeros((3, 6))
    full = covariance.solve_step(information, zeros, zeros, weights)
    information[1] = 0
    covered = covariance.solve_step(information, zeros, zeros, weights)
    assert full is not None
    assert covered is not None
    difference = np.linalg.inv(covered.information) - np.linalg.inv(full.information)
    assert (np.linalg.eigvalsh(difference) > 0).all()


def test_unstated_calibration_counts_as_exact():
    camera = dataclasses.replace(make_camera(), camera_from_world_std=None)
    stated = covariance.calibration_covariance(camera)
    assert np.sqrt(np.diag(stated)).max() < 1e-4
