from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.optimize import nnls

from tests.helpers import make_camera, random_rotations
from tracker.calibration.deviations import calibration_covariance, element_std, rotation_vector_variance
from tracker.geometry import so3


def test_element_wise_std_gives_back_the_rotation_vectors(rng):
    for rotation in random_rotations(rng, 5):
        variances = rng.uniform(0.5, 2.0, 3) * 1e-6
        design = [(so3.hat(axis) @ rotation) ** 2 for axis in np.eye(3)]
        std = np.sqrt(np.tensordot(variances, design, axes=1))
        np.testing.assert_allclose(rotation_vector_variance(rotation, std), variances, rtol=1e-6, atol=1e-12)


def test_what_no_rotation_vector_fits_is_met_as_nearly_as_by_scipy(rng):
    negative = 0
    for rotation in random_rotations(rng, 20):
        std = rng.uniform(0.0, 2e-3, (3, 3))
        design = np.stack([(so3.hat(axis) @ rotation).ravel() ** 2 for axis in np.eye(3)], axis=1)
        expected, _ = nnls(design, std.ravel() ** 2)
        negative += expected.min() == 0.0
        np.testing.assert_allclose(rotation_vector_variance(rotation, std), expected, rtol=1e-9, atol=1e-18)
    assert 0 < negative < 20


def test_unstated_calibration_counts_as_exact():
    camera = dataclasses.replace(make_camera(), camera_from_world_std=None)
    assert np.sqrt(np.diag(calibration_covariance(camera))).max() < 1e-4


@pytest.mark.parametrize("azimuth", [0, 77, 300])
def test_what_is_stated_element_by_element_reads_back_as_the_same_covariance(azimuth, rng):
    camera = make_camera(azimuth)
    rotation = camera.camera_from_world[:3, :3]
    # Errors along the camera's own axes, which is all that elements can state.
    turned = np.kron(np.eye(2), rotation.T)
    stated = turned @ np.diag(rng.uniform(0.2, 2.0, 6) * 1e-6) @ turned.T
    told = dataclasses.replace(camera, camera_from_world_std=element_std(rotation, stated))
    np.testing.assert_allclose(calibration_covariance(told), stated, rtol=1e-5, atol=1e-11)
