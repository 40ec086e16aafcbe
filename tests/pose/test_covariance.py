import numpy as np
import pytest

from tests.helpers import make_camera
from tracker.calibration.deviations import calibration_covariance, rotation_vector_variance
from tracker.geometry import so3
from tracker.pose.solve import MODEL_STD, add_model_errors, offset_weights


def test_camera_offset_is_what_samples_of_the_calibration_show(rng):
    camera, position = make_camera(), np.array([0.05, -0.08, 0.03])
    known = np.linalg.inv(calibration_covariance(camera))
    weights = np.empty((6, 6))
    offset_weights(known, position, weights)
    np.testing.assert_allclose(weights, weights.T, rtol=1e-9, atol=1e-9)
    stated = np.linalg.inv(weights)
    assert camera.camera_from_world_std is not None
    rotation, translation = camera.camera_from_world[:3, :3], camera.camera_from_world[:3, 3]
    variances = rotation_vector_variance(rotation, camera.camera_from_world_std[:3, :3])
    errors = []
    for _ in range(4000):
        turn = so3.exp(rng.normal(size=3) * np.sqrt(variances))
        shift = rng.normal(size=3) * camera.camera_from_world_std[:3, 3]
        # Where a true camera sees the object, and which offset explains that with the stated camera.
        seen = turn @ rotation @ position + translation + shift
        moved = rotation.T @ (seen - translation) - position
        errors.append(np.concatenate([moved, so3.log(rotation.T @ turn @ rotation)]))
    np.testing.assert_allclose(np.cov(np.array(errors).T), stated, rtol=0.1, atol=0.06 * stated.max())


@pytest.mark.parametrize("radius", [0.02, 0.06])
def test_a_covariance_is_never_less_than_the_models_errors(rng, radius):
    root = 1e-3 * rng.normal(size=(6, 6))
    measured = root @ root.T
    stated, nothing, transposed = measured.copy(), np.zeros((6, 6)), np.asfortranarray(measured)
    for covariance in (stated, nothing, transposed):
        add_model_errors(covariance, radius)
    np.testing.assert_array_equal(stated, stated.T)
    shift, turn = MODEL_STD
    errors = np.diag(np.repeat(np.square([shift * radius, turn]), 3))
    np.testing.assert_allclose(stated - errors, measured, rtol=1e-6, atol=1e-18)
    np.testing.assert_allclose(nothing, errors, rtol=1e-12)
    # In memory as a solver may leave it.
    np.testing.assert_array_equal(transposed, stated)
