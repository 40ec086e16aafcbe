"""Errors of cameras and of poses, against least-squares problems that have them as unknowns."""

import dataclasses

import numpy as np
import pytest
from scipy.optimize import nnls

from tests.helpers import make_camera, random_rotations
from tracker.calibration.by_object.edges import Contour, pose_errors, pose_information, seen_motion
from tracker.calibration.deviations import calibration_covariance, element_std, rotation_vector_variance
from tracker.geometry import so3

CAMERAS = tuple(make_camera(azimuth) for azimuth in (60, 180, 300))
POSITION = np.array([0.06, -0.09, 0.03])
RIM_STD = 3e-4


def made_contour(rng, count=60):
    jacobian = rng.normal(size=(count, 6)) * np.repeat([500.0, 12.0], 3)
    return Contour(
        pixel=rng.uniform(-80, 80, (count, 2)),
        normal=np.tile([1.0, 0.0], (count, 1)),
        jacobian=jacobian,
        bloom=rng.uniform(0, 0.2, count),
        rim=rng.uniform(200, 500, count),
        offset=rng.normal(0, 0.1, count),
        variance=np.full(count, 0.1**2),
        edge=rng.integers(0, 9, count),
        foot=np.zeros(count),
        scale=1.0,
    )


def test_own_and_shared_errors_add_up_to_what_joint_least_squares_says(rng):
    contours = [made_contour(rng, count) for count in (60, 40, 90)]
    own, common = pose_errors(contours, POSITION, CAMERAS, RIM_STD)
    known = np.zeros((24, 24))
    motion = seen_motion(POSITION)
    for c, (contour, camera) in enumerate(zip(contours, CAMERAS, strict=True)):
        its = np.zeros((6, 24))
        its[:, :6], its[:, 6 + 6 * c : 12 + 6 * c] = np.eye(6), motion
        known += its.T @ pose_information(contour, RIM_STD) @ its
        block = slice(6 + 6 * c, 12 + 6 * c)
        known[block, block] += np.linalg.inv(calibration_covariance(camera))
    expected = np.linalg.inv(known)[:6, :6]
    total = own.copy()
    for c, camera in enumerate(CAMERAS):
        total += common[:, c] @ calibration_covariance(camera) @ common[:, c].T
    np.testing.assert_allclose(total, expected, rtol=2e-3, atol=1e-3 * np.abs(expected).max())


def test_cameras_that_err_alike_move_the_pose_as_much_and_one_that_sees_nothing_not(rng):
    _, common = pose_errors([made_contour(rng) for _ in CAMERAS], POSITION, CAMERAS, RIM_STD)
    np.testing.assert_allclose(common.sum(axis=1), seen_motion(POSITION), atol=5e-3)
    _, common = pose_errors([made_contour(rng), None, made_contour(rng)], POSITION, CAMERAS, RIM_STD)
    assert not common[:, 1].any()
    assert common[:, 0].any()


def test_a_point_moves_as_the_world_does(rng):
    error = rng.normal(size=6) * 1e-6
    moved = so3.exp(error[3:]) @ POSITION + error[:3]
    np.testing.assert_allclose(seen_motion(POSITION) @ error, [*(moved - POSITION), *error[3:]], atol=1e-11)


@pytest.mark.parametrize("own", [0.0, 0.05**2])
def test_offsets_that_pieces_share_are_as_unknowns_of_their_own(own, rng):
    contour = made_contour(rng, 30)
    columns, weight = rng.normal(size=(30, 4)), rng.uniform(0, 1, 30)
    covariance = np.diag(contour.variance / weight) + own * (contour.edge[:, None] == contour.edge)
    expected = columns.T @ np.linalg.solve(covariance, columns)
    np.testing.assert_allclose(contour.information(columns, weight, own), expected, rtol=1e-9)


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
    known = dataclasses.replace(camera, camera_from_world_std=element_std(rotation, stated))
    np.testing.assert_allclose(calibration_covariance(known), stated, rtol=1e-5, atol=1e-11)


def test_edges_that_may_stand_in_a_shadow_say_less(rng):
    contour = made_contour(rng)
    columns, weight = np.column_stack([contour.jacobian, contour.rim]), np.ones(60)
    for own in (0.0, 0.1**2):
        sharp = contour.information(columns, weight, own)
        standing = dataclasses.replace(contour, foot=np.where(contour.edge < 3, 0.5, 0.0))
        less = sharp - standing.information(columns, weight, own)
        assert np.linalg.eigvalsh(less).min() > -1e-9 * np.abs(sharp).max()
        # An offset of each of three edges is unknown, each of which takes one direction.
        assert np.linalg.matrix_rank(less, tol=1e-9 * np.abs(sharp).max()) == 3
