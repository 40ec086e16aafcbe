from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from tracker.errors import TaskError
from tracker.tasks import move_object
from tracker.tasks.move_object import (
    episode_reward,
    long_axis_error,
    position_error,
    reward,
    rotation_error,
    weighted_total,
)

ZERO, UNIT = [0.0, 0, 0], [0.0, 0, 0, 1]


@pytest.mark.parametrize(
    ("function", "arguments", "message"),
    [
        (position_error, (None, ZERO), "goal_position: found None, expected numbers"),
        (position_error, (ZERO, [0, 0]), r"^position: found shape \(2,\), expected \(\.\.\., 3\)"),
        (position_error, (ZERO, [[0, 0, 0], [0, 0]]), "^position: found .* expected numbers"),
        (position_error, (ZERO, ["0", "0", "0"]), "^position: found .* expected numbers"),
        (position_error, (ZERO, 0.0), r"^position: found shape \(\)"),
        (position_error, ([0, 0, np.nan], ZERO), "goal_position: found nan, expected finite"),
        (position_error, (ZERO, [0, 0, 1e300]), r"^position: found 1e\+300, expected finite"),
        (position_error, (np.ones((2, 3)), np.ones((5, 3))), r"found shapes \(2, 3\) and \(5, 3\)"),
        (rotation_error, (UNIT, ZERO), r"^orientation: found shape \(3,\), expected \(\.\.\., 4\)"),
        (rotation_error, (UNIT, [0, 0, 0, 0]), "^orientation: found a quaternion of length 0"),
        (long_axis_error, ([0, 0, 0, 0], UNIT), "goal_orientation: found a quaternion of length 0"),
        (partial(long_axis_error, axis=3), (UNIT, UNIT), "axis: found 3, expected 0, 1 or 2"),
        *[(reward, (n, ZERO, ZERO), f"level: found {n}, expected 1, 2, 3 or 4") for n in (5, 0, 2.0, True)],
        (reward, (4, ZERO, ZERO), "goal_orientation: found None, .* at level 4"),
        (reward, (4, ZERO, ZERO, UNIT), "^orientation: found None, .* at level 4"),
        (reward, (4, ZERO, np.zeros((5, 3)), UNIT, np.ones((2, 4))), r"found shapes \(5,\) and \(2,\)"),
        (episode_reward, (1.0,), "rewards: found a single number"),
        (partial(episode_reward, steps=-1), ([1.0, 2.0],), "steps: found -1, expected no negative"),
        (partial(episode_reward, steps=[1, 2]), ([1.0],), r"steps: found shape \(2,\), expected one number"),
        (weighted_total, ({1: [0.0]},), "levels of episode rewards: found 1, expected each of"),
        (weighted_total, ({1: [0.0], 2: [0.0], 3: [], 4: [0.0]},), "episode rewards of level 3: found none"),
    ],
)
def test_a_fault_names_the_argument_what_was_found_and_what_would_do(function, arguments, message):
    with pytest.raises(TaskError, match=message):
        function(*arguments)


@pytest.mark.parametrize(
    ("trajectory", "message"),
    [
        ([], "found no goals, expected at least one"),
        ({"goal": [(0, ZERO)]}, "found a dict, expected a list of pairs"),
        (None, "found a NoneType, expected a list of pairs"),
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
    ],
)
def test_a_malformed_trajectory_is_refused(trajectory, message):
    with pytest.raises(TaskError, match=f"^trajectory: {message}"):
        move_object.active_goal(trajectory, 0)


@pytest.mark.parametrize("time", [-1, [0, -0.5], np.nan])
def test_before_a_trajectory_begins_there_is_no_goal(time):
    with pytest.raises(TaskError, match=r"^time: found"):
        move_object.trajectory_reward([(0, ZERO)], time, ZERO)
