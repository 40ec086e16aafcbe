import dataclasses
import itertools
from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from tests.helpers import random_rotations
from tracker.errors import TaskError
from tracker.geometry import cuboid, so3
from tracker.objects.model import load_object, object_names
from tracker.pose.result import PoseEstimate
from tracker.tasks import move_object as task
from tracker.tasks.move_object import episode_reward, keypoints, pose_from_keypoints, position_error, reward

CUBE, CUBOID = load_object("cube_v2"), load_object("cuboid_2x2x8_v2")

# From no rotation to half a turn, with both ends sampled on purpose.
ANGLES = [0.0, 1e-12, 1e-9, 1e-7, 1e-5, 1e-3, 0.1, 1.0, np.pi / 2, 3.0, np.pi - 1e-5, np.pi - 1e-9, np.pi]

positions = arrays(np.float64, 3, elements=st.floats(-1, 1))
sizes = arrays(np.float64, 3, elements=st.floats(0.005, 0.5))
quaternions = arrays(np.float64, 4, elements=st.floats(-1, 1)).filter(lambda q: np.linalg.norm(q) > 1e-3)

ZERO, UNIT = [0.0, 0, 0], [0.0, 0, 0, 1]
BOX = np.array([0.02, 0.08, 0.03])
CORNERS = keypoints([0.1, 0.0, 0.03], UNIT, BOX)
ONE_NUMBER = np.arange(24).reshape(8, 3) == 5


def random_quaternions(rng: np.random.Generator, count: int = 60) -> np.ndarray:
    return so3.quaternion_from_matrix(random_rotations(rng, count))


def turned(quaternion: np.ndarray, rotvec: np.ndarray) -> np.ndarray:
    """Orientations turned by rotation vectors in the object's frame [rad]."""
    return so3.quaternion_from_matrix(so3.matrix_from_quaternion(quaternion) @ so3.exp(rotvec))


@pytest.mark.parametrize(
    ("offset", "error"),
    [
        ([0.39, 0, 0], 0.5),
        ([0, -0.39, 0], 0.5),
        ([0, 0, 0.1], 0.5),
        ([0, 0, -0.1], 0.5),
        ([0.09, -0.12, 0.04], (0.15 / 0.39 + 0.4) / 2),
    ],
)
def test_horizontal_distance_counts_by_the_arenas_diameter_and_height_by_a_decimetre(offset, error):
    goal = np.array([0.05, -0.1, 0.06])
    np.testing.assert_allclose(position_error(goal, goal + offset), error, rtol=1e-12)


@given(positions, positions, positions, st.floats(-4, 4))
def test_position_error_is_a_metric_that_moving_the_world_or_turning_it_about_z_does_not_change(a, b, c, yaw):
    assert position_error(a, a) == 0
    assert position_error(a, b) == position_error(b, a) >= 0
    assert position_error(a, c) <= position_error(a, b) + position_error(b, c) + 1e-12
    turn = so3.exp([0, 0, yaw])
    np.testing.assert_allclose(position_error(turn @ a + c, turn @ b + c), position_error(a, b), atol=1e-12)


@pytest.mark.parametrize("angle", ANGLES)
def test_rotation_error_is_the_angle_over_pi(angle, rng):
    goal = random_quaternions(rng)
    axis = rng.normal(size=goal[:, :3].shape)
    rotvec = angle * axis / np.linalg.norm(axis, axis=1, keepdims=True)
    error = task.rotation_error(goal, turned(goal, rotvec))
    np.testing.assert_allclose(error, angle / np.pi, rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize("angle", ANGLES)
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_long_axis_error_is_the_angle_of_the_axis_over_pi_and_a_turn_about_it_costs_nothing(angle, axis, rng):
    goal = random_quaternions(rng)
    along = np.eye(3)[axis]
    across = np.cross(along, rng.normal(size=goal[:, :3].shape))
    across *= angle / np.linalg.norm(across, axis=1, keepdims=True)
    tilted = turned(turned(goal, across), rng.uniform(-np.pi, np.pi, (len(goal), 1)) * along)
    chosen = {} if axis == 1 else {"axis": axis}  # y by default
    error = task.long_axis_error(goal, tilted, **chosen)
    np.testing.assert_allclose(error, angle / np.pi, rtol=0, atol=1e-15)


@pytest.mark.parametrize("error", [task.rotation_error, task.long_axis_error])
@given(quaternions, quaternions, quaternions)
def test_orientation_errors_are_metrics_up_to_1_that_turning_the_world_does_not_change(error, a, b, world):
    assert error(a, a) == 0
    assert 0 <= error(a, b) <= task.rotation_error(a, b) + 1e-15 <= 1 + 1e-15
    np.testing.assert_allclose(error(a, b), error(b, a), atol=1e-15)
    np.testing.assert_allclose(error(a, b), error(-a, b), atol=1e-15)
    np.testing.assert_allclose(error(a, b), error(0.5 * a, 2 * b), atol=1e-15)
    assert error(a, b) <= error(a, world) + error(world, b) + 1e-12
    turn = so3.matrix_from_quaternion(world)
    a, b = (so3.quaternion_from_matrix(turn @ so3.matrix_from_quaternion(q)) for q in (a, b))
    np.testing.assert_allclose(error(a, b), error(-b, a), atol=1e-15)


def test_an_object_has_a_long_axis_where_one_edge_is_twice_the_others():
    found = {name: task.long_axis(load_object(name)) for name in object_names()}
    assert found == {name: 1 if "cuboid" in name else None for name in object_names()}
    for size in set(itertools.permutations([0.02, 0.02, 0.08])):
        model = dataclasses.replace(CUBOID, size=np.array(size))
        assert task.long_axis(model) == size.index(0.08)
    for size in ([0.065, 0.065, 0.0652], [0.02, 0.08, 0.08], [0.02, 0.03, 0.04]):
        assert task.long_axis(dataclasses.replace(CUBOID, size=np.array(size))) is None


@pytest.mark.parametrize("model", [None, CUBE, CUBOID])
def test_level_4_alone_looks_at_the_orientation_by_half(model, rng):
    goal, actual = rng.uniform(-0.1, 0.1, (2, 40, 3))
    goal_turn, turn = random_quaternions(rng, 40), random_quaternions(rng, 40)
    error = position_error(goal, actual)
    for level, turns in itertools.product((1, 2, 3), ((), (goal_turn, turn))):
        np.testing.assert_array_equal(reward(level, goal, actual, *turns, model=model), -error)
    turning = task.long_axis_error if model is CUBOID else task.rotation_error
    rewards = reward(4, goal, actual, goal_turn, turn, model=model)
    np.testing.assert_allclose(rewards, -(error + turning(goal_turn, turn)) / 2, rtol=1e-15)


@pytest.mark.parametrize("level", task.LEVELS)
@pytest.mark.parametrize("model", [CUBE, CUBOID])
def test_nothing_is_better_than_the_goal_itself(level, model, rng):
    goal, turn = rng.uniform(-0.1, 0.1, (30, 3)), random_quaternions(rng, 30)
    best = reward(level, goal, goal, turn, turn, model=model)
    np.testing.assert_array_equal(best, 0)
    assert not np.signbit(best).any()
    assert (reward(level, goal[::-1], goal, turn[::-1], turn, model=model) < 0).all()


def test_one_goal_and_many_states_broadcast(rng):
    states, turns = rng.normal(size=(4, 5, 3)), random_quaternions(rng, 20).reshape(4, 5, 4)
    goal, goal_turn = rng.normal(size=3), random_quaternions(rng, 1)[0]
    rewards = reward(4, goal, states, goal_turn, turns, model=CUBOID)
    assert rewards.shape == (4, 5)
    lists = map(list, (goal, states[2, 3], goal_turn, turns[2, 3]))
    one = reward(4, *lists, model=CUBOID)
    assert np.shape(one) == ()
    assert rewards[2, 3] == pytest.approx(one, rel=1e-14)
    assert reward(1, goal, np.empty((0, 3))).shape == (0,)


def test_where_the_object_was_not_seen_the_reward_is_unknown(rng):
    states, turns = rng.normal(size=(5, 3)), random_quaternions(rng, 5)
    states[1], turns[3, 0] = np.nan, np.nan
    rewards = reward(4, states[0], states, turns[0], turns, model=CUBE)
    np.testing.assert_array_equal(np.isnan(rewards), [False, True, False, True, False])
    axis = task.long_axis_error(turns[0], turns)
    np.testing.assert_array_equal(np.isnan(axis), [False, False, False, True, False])
    assert np.isnan(episode_reward(rewards))


@given(st.lists(st.integers(1, 20000), max_size=9), st.lists(st.floats(0, 120000), min_size=1, max_size=9))
def test_the_active_goal_whose_reward_counts_is_the_last_that_has_begun_in_any_unit_of_time(pauses, times):
    starts = np.cumsum([0, *pauses])
    times = np.array([*times, *starts, *(starts[1:] - 0.5)])
    goals = [[float(k), 0, k / 8] for k in range(len(starts))]
    trajectory = list(zip(starts.tolist(), goals, strict=True))
    expected = [goals[np.flatnonzero(starts <= time)[-1]] for time in times]
    np.testing.assert_array_equal(task.active_goal(trajectory, times), expected)
    np.testing.assert_array_equal(task.active_goal(trajectory, times[0]), expected[0])
    halves = [(start / 2, goal) for start, goal in trajectory]
    np.testing.assert_array_equal(task.active_goal(halves, times[None] / 2), [expected])
    # Rewards along the trajectory are those of the active goals.
    states = np.random.default_rng(1).normal(0, 0.1, (len(times), 3))
    rewards = task.trajectory_reward(trajectory, times, states)
    np.testing.assert_array_equal(rewards, reward(3, expected, states))


def test_an_episodes_reward_sums_its_steps(rng):
    rewards = -rng.random((3, 1200))
    assert episode_reward(rewards[0]) == pytest.approx(rewards[0].sum())
    for steps in (100, rng.integers(0, 200, 1200)):
        every = episode_reward(np.repeat(rewards, steps, axis=1))
        np.testing.assert_allclose(episode_reward(rewards, steps=steps), every, rtol=1e-12)


def test_the_total_weights_each_level_by_its_number():
    episodes = {1: [-1.0, -3.0], 2: [-10.0], 3: np.array([-5.0, -5.0, -20.0]), 4: [-100.0]}
    assert task.weighted_total(episodes) == pytest.approx(-2 - 2 * 10 - 3 * 10 - 4 * 100)
    assert task.weighted_total(episodes, median=True) == pytest.approx(-2 - 2 * 10 - 3 * 5 - 4 * 100)


def test_a_corner_is_on_the_plus_side_where_its_bit_is_zero():
    found = keypoints([1.0, 2.0, 3.0], UNIT, BOX)
    for i, corner in enumerate(found):
        signs = [1 if not i >> axis & 1 else -1 for axis in range(3)]
        np.testing.assert_allclose(corner, [1.0, 2.0, 3.0] + BOX / 2 * signs)
    assert np.array_equal(keypoints(np.zeros(3), UNIT, BOX)[::-1], cuboid.corners(BOX))


@given(sizes, positions, quaternions, quaternions)
def test_a_poses_corners_turn_with_it_and_lead_back_to_it(size, position, orientation, other):
    corners = keypoints(position, orientation, size)
    pose = PoseEstimate(position, orientation / np.linalg.norm(orientation), np.eye(6), 0.9, size=size)
    np.testing.assert_allclose(pose.keypoints, corners, atol=1e-15)
    place, turn = pose_from_keypoints(corners, size)
    np.testing.assert_allclose(place, position, atol=1e-12)
    unit, rotation = (so3.matrix_from_quaternion(q / np.linalg.norm(q)) for q in (orientation, other))
    assert so3.angle_between(so3.matrix_from_quaternion(turn), unit) < 1e-7
    assert turn[3] >= 0
    turned = keypoints(rotation @ position, so3.quaternion_from_matrix(rotation @ unit), size)
    np.testing.assert_allclose(turned, corners @ rotation.T, atol=1e-12)


def test_many_states_go_at_once_and_one_that_was_not_seen_stays_unknown():
    rng = np.random.default_rng(3)
    places = rng.uniform(-0.2, 0.2, (5, 4, 3))
    turns = so3.quaternion_from_matrix(random_rotations(rng, 20).reshape(5, 4, 3, 3))
    places[2, 1], turns[3, 0] = np.nan, np.nan
    corners = keypoints(places, turns, BOX)
    assert corners.shape == (5, 4, 8, 3)
    assert np.isnan(corners).all(axis=(2, 3)).sum() == 2
    known = ~np.isnan(corners).any(axis=(2, 3))
    for found, expected in zip(pose_from_keypoints(corners, BOX), (places, turns), strict=True):
        np.testing.assert_allclose(found[known], expected[known], atol=1e-12)
        assert np.isnan(found[~known]).all()
    assert keypoints(places[0], UNIT, BOX).shape == (4, 8, 3)


def test_noise_on_corners_averages_out():
    rng = np.random.default_rng(4)
    corners = keypoints([0.1, 0.0, 0.03], [0.1, 0.2, 0.3, 0.9], BOX)
    noisy = corners + rng.normal(0, 1e-4, (2000, 8, 3))
    place, _ = pose_from_keypoints(noisy, BOX)
    assert np.std(place, axis=0) == pytest.approx(np.full(3, 1e-4 / np.sqrt(8)), rel=0.1)


@pytest.mark.parametrize(
    ("function", "arguments", "message"),
    [
        (position_error, (None, ZERO), "goal_position: found None, expected numbers"),
        (position_error, (ZERO, [0, 0]), r"^position: found shape \(2,\), expected \(\.\.\., 3\)"),
        (position_error, (ZERO, [[0, 0, 0], [0, 0]]), "^position: found .* expected numbers"),
        (position_error, ([0, 0, np.nan], ZERO), "goal_position: found nan, expected finite"),
        (position_error, (ZERO, [0, 0, 1e300]), r"^position: found 1e\+300, expected finite"),
        (position_error, (np.ones((2, 3)), np.ones((5, 3))), r"found shapes \(2, 3\) and \(5, 3\)"),
        (task.rotation_error, (UNIT, ZERO), r"^orientation: found shape \(3,\), expected \(\.\.\., 4\)"),
        (task.rotation_error, (UNIT, [0, 0, 0, 0]), "^orientation: found a quaternion of length 0"),
        (task.long_axis_error, ([0, 0, 0, 0], UNIT), "goal_orientation: found a quaternion of length 0"),
        (partial(task.long_axis_error, axis=3), (UNIT, UNIT), "axis: found 3, expected 0, 1 or 2"),
        *[(reward, (n, ZERO, ZERO), f"level: found {n}, expected 1, 2, 3 or 4") for n in (5, 0, 2.0, True)],
        (reward, (4, ZERO, ZERO), "goal_orientation: found None, .* at level 4"),
        (reward, (4, ZERO, ZERO, UNIT), "^orientation: found None, .* at level 4"),
        (reward, (4, ZERO, np.zeros((5, 3)), UNIT, np.ones((2, 4))), r"found shapes \(5,\) and \(2,\)"),
        (episode_reward, (1.0,), "rewards: found a single number"),
        (partial(episode_reward, steps=-1), ([1.0, 2.0],), "steps: found -1, expected no negative"),
        (partial(episode_reward, steps=[1, 2]), ([1.0],), r"steps: found shape \(2,\), expected one number"),
        (task.weighted_total, ({1: [0.0]},), "levels of episode rewards: found 1, expected each of"),
        (
            task.weighted_total,
            ({1: [0.0], 2: [0.0], 3: [], 4: [0.0]},),
            "episode rewards of level 3: found none",
        ),
        *[
            (task.active_goal, (trajectory, 0), f"^trajectory: {message}")
            for trajectory, message in [
                ([], "found no goals, expected at least one"),
                ({"goal": [(0, ZERO)]}, "found a mapping of 1, expected a list of pairs"),
                ([(0, ZERO, ZERO)], "entry 0: found .* expected a pair"),
                ([(0, ZERO), 3], "entry 1: found 3, expected a pair"),
                ([(0, [0, 0])], "entry 0: found .* expected a number and 3 numbers"),
                ([([0, 1], ZERO)], "entry 0: found .* expected a number and 3 numbers"),
                ([(0, ZERO), (1, [0, np.nan, 0])], "position 1: found nan, expected finite"),
                ([(0, ZERO), (np.inf, ZERO)], "time 1: found inf, expected finite"),
                ([("now", ZERO)], "time 0: found 'now', expected numbers"),
                ([(1, ZERO)], "found 1 as the first time, expected 0"),
                ([(0, ZERO), (5, ZERO), (5, ZERO)], "time 2: found 5, expected more than 5"),
                ([(0, ZERO), (5, ZERO), (4, ZERO)], "time 2: found 4, expected more than 5"),
            ]
        ],
        *[(task.trajectory_reward, ([(0, ZERO)], t, ZERO), "^time: found") for t in (-1, [0, -0.5], np.nan)],
        (pose_from_keypoints, (CORNERS[::-1], BOX), "found a corner .* mm from that of a box of 20×80×30 mm"),
        (pose_from_keypoints, (CORNERS * [1, 1, -1], BOX), "found a corner"),
        (pose_from_keypoints, (CORNERS, BOX[[1, 0, 2]]), "box of 80×20×30 mm"),
        (pose_from_keypoints, (CORNERS + 0.002 * ONE_NUMBER, BOX), "expected at most 1 mm"),
        (pose_from_keypoints, (np.zeros((8, 3)), BOX), "found a corner"),
        (pose_from_keypoints, (CORNERS[:7], BOX), r"shape \(7, 3\)"),
        (pose_from_keypoints, (np.full((8, 3), np.inf), BOX), "expected finite numbers"),
        *[
            (partial(pose_from_keypoints, tolerance=far), (CORNERS, BOX), f"tolerance: found {far}, expected")
            for far in (-1, np.inf, None)
        ],
        (pose_from_keypoints, (CORNERS, [0.02, 0.08]), "three lengths"),
        (pose_from_keypoints, (CORNERS, [0.02, 0.08, 0.0]), "above 0 m"),
        (keypoints, ([0.0, 0.0], UNIT, BOX), r"position: found shape \(2,\)"),
        (keypoints, (ZERO, [0.0] * 4, BOX), "length 0"),
        (keypoints, (np.zeros((2, 3)), np.tile(UNIT, (3, 1)), BOX), "expected leading axes"),
    ],
)
def test_a_fault_names_the_argument_what_was_found_and_what_would_do(function, arguments, message):
    with pytest.raises(TaskError, match=message):
        function(*arguments)
