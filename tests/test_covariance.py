from __future__ import annotations

import dataclasses

import numpy as np

from tests.helpers import make_camera, random_rotations
from tracker.geometry import so3
from tracker.pose.solve import covariance


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


def test_unstated_calibration_counts_as_exact():
    camera = dataclasses.replace(make_camera(), camera_from_world_std=None)
    stated = covariance.calibration_covariance(camera)
    assert np.sqrt(np.diag(stated)).max() < 1e-4


def test_covariance_is_the_inverse_information_and_never_less_than_the_models_errors(rng):
    root = 1e4 * rng.normal(size=(6, 6))
    information = root @ root.T + 1e6 * np.eye(6)
    stated = covariance.pose_covariance(information)
    np.testing.assert_array_equal(stated, stated.T)
    np.testing.assert_allclose(
        stated - np.diag(covariance.MODEL_STD**2), np.linalg.inv(information), rtol=1e-6, atol=1e-18
    )
    exact = covariance.pose_covariance(1e30 * np.eye(6))
    np.testing.assert_allclose(exact, np.diag(covariance.MODEL_STD**2), atol=1e-20)
