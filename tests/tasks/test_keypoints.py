"""Corners in place of poses: there and back, whatever the rotation."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from tests.helpers import random_rotations
from tracker.errors import TaskError
from tracker.geometry import cuboid, so3
from tracker.pose.result import PoseEstimate
from tracker.tasks.move_object import keypoints, pose_from_keypoints

sizes = arrays(np.float64, 3, elements=st.floats(0.005, 0.5))
positions = arrays(np.float64, 3, elements=st.floats(-1, 1))
quaternions = arrays(np.float64, 4, elements=st.floats(-1, 1)).filter(lambda q: np.linalg.norm(q) > 1e-3)

BOX = np.array([0.02, 0.08, 0.03])
IDENTITY = [0.0, 0.0, 0.0, 1.0]


def test_a_corner_is_on_the_plus_side_where_its_bit_is_zero():
    found = keypoints([1.0, 2.0, 3.0], IDENTITY, BOX)
    for i, corner in enumerate(found):
        signs = [1 if not i >> axis & 1 else -1 for axis in range(3)]
        np.testing.assert_allclose(corner, [1.0, 2.0, 3.0] + BOX / 2 * signs)
    assert np.array_equal(keypoints(np.zeros(3), IDENTITY, BOX)[::-1], cuboid.corners(BOX))


@given(sizes, positions, quaternions)
def test_a_pose_comes_back_from_its_corners(size, position, orientation):
    corners = keypoints(position, orientation, size)
    place, turn = pose_from_keypoints(corners, size)
    np.testing.assert_allclose(place, position, atol=1e-12)
    unit = orientation / np.linalg.norm(orientation)
    assert so3.angle_between(so3.matrix_from_quaternion(turn), so3.matrix_from_quaternion(unit)) < 1e-7
    assert turn[3] >= 0


@given(sizes, positions, quaternions, quaternions)
def test_turning_the_object_turns_its_corners(size, position, orientation, turn):
    rotation = so3.matrix_from_quaternion(turn / np.linalg.norm(turn))
    unit = so3.matrix_from_quaternion(orientation / np.linalg.norm(orientation))
    turned = keypoints(rotation @ position, so3.quaternion_from_matrix(rotation @ unit), size)
    np.testing.assert_allclose(turned, keypoints(position, orientation, size) @ rotation.T, atol=1e-12)


def test_many_states_go_at_once_and_one_that_was_not_seen_stays_unknown():
    rng = np.random.default_rng(3)
    places = rng.uniform(-0.2, 0.2, (5, 4, 3))
    turns = so3.quaternion_from_matrix(random_rotations(rng, 20).reshape(5, 4, 3, 3))
    places[2, 1], turns[3, 0] = np.nan, np.nan
    corners = keypoints(places, turns, BOX)
    assert corners.shape == (5, 4, 8, 3)
    assert np.isnan(corners).all(axis=(2, 3)).sum() == 2
    place, turn = pose_from_keypoints(corners, BOX)
    known = ~np.isnan(corners).any(axis=(2, 3))
    np.testing.assert_allclose(place[known], places[known], atol=1e-12)
    np.testing.assert_allclose(turn[known], turns[known], atol=1e-12)
    assert np.isnan(place[~known]).all()
    assert np.isnan(turn[~known]).all()
    assert keypoints(places[0], IDENTITY, BOX).shape == (4, 8, 3)


def test_noise_on_corners_averages_out():
    rng = np.random.default_rng(4)
    corners = keypoints([0.1, 0.0, 0.03], [0.1, 0.2, 0.3, 0.9], BOX)
    noisy = corners + rng.normal(0, 1e-4, (2000, 8, 3))
    place, _ = pose_from_keypoints(noisy, BOX)
    assert np.std(place, axis=0) == pytest.approx(np.full(3, 1e-4 / np.sqrt(8)), rel=0.1)


CORNERS = keypoints([0.1, 0.0, 0.03], IDENTITY, BOX)


@pytest.mark.parametrize(
    ("corners", "size", "says"),
    [
        (CORNERS[::-1], BOX, "found a corner .* mm from that of a box of 20×80×30 mm"),
        (CORNERS * [1, 1, -1], BOX, "found a corner"),
        (CORNERS, BOX[[1, 0, 2]], "box of 80×20×30 mm"),
        (CORNERS + 0.002 * (np.arange(24).reshape(8, 3) == 5), BOX, "expected at most 1 mm"),
        (np.zeros((8, 3)), BOX, "found a corner"),
        (CORNERS[:7], BOX, r"shape \(7, 3\)"),
        (np.full((8, 3), np.inf), BOX, "expected finite numbers"),
        ("box", BOX, "expected numbers"),
        (CORNERS, [0.02, 0.08], "three lengths"),
        (CORNERS, [0.02, 0.08, 0.0], "above 0 m"),
    ],
)
def test_what_is_no_box_is_refused(corners, size, says):
    with pytest.raises(TaskError, match=says):
        pose_from_keypoints(corners, size)


@pytest.mark.parametrize(
    ("position", "orientation", "says"),
    [
        ([0.0, 0.0], IDENTITY, r"position: found shape \(2,\)"),
        ([0.0, 0.0, 0.0], [0.0] * 4, "length 0"),
        (np.zeros((2, 3)), np.tile(IDENTITY, (3, 1)), "expected leading axes"),
        (None, IDENTITY, "expected numbers"),
    ],
)
def test_what_is_no_pose_has_no_corners(position, orientation, says):
    with pytest.raises(TaskError, match=says):
        keypoints(position, orientation, BOX)


def test_a_poses_keypoints_are_those_of_the_task():
    turn = np.array([0.1, 0.2, 0.3, 0.9])
    turn /= np.linalg.norm(turn)
    pose = PoseEstimate([0.1, 0.0, 0.03], turn, np.eye(6), 0.9, size=BOX)
    np.testing.assert_allclose(pose.keypoints, keypoints(pose.position, turn, BOX), atol=1e-15)
