"""Rewards of control steps, of episodes, and of all levels of difficulty."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from tracker.checks import is_whole, of_kind
from tracker.conventions import FloatArray
from tracker.errors import TaskError, shown
from tracker.objects.model import CuboidModel
from tracker.tasks.move_object.checks import check_fit, numbers
from tracker.tasks.move_object.errors import long_axis_error, position_error, rotation_error

LEVELS = (1, 2, 3, 4)
"""Levels of difficulty: on the table, lifted, anywhere in the air; 4 with an orientation."""

LONG = 2.0
"""Least ratio of the longest edge to the next at which an object has a long axis."""


def long_axis(model: CuboidModel) -> int | None:
    """The object's long axis (0, 1 or 2): of an edge at least twice as long as the others; else None."""
    of_kind(model, CuboidModel, "model", TaskError, "tracker.load_object")
    shorter, longest = np.sort(model.size)[1:]
    return int(np.argmax(model.size)) if longest >= LONG * shorter else None


def reward(
    level: int,
    goal_position: npt.ArrayLike,
    position: npt.ArrayLike,
    goal_orientation: npt.ArrayLike | None = None,
    orientation: npt.ArrayLike | None = None,
    *,
    model: CuboidModel | None = None,
) -> FloatArray:
    """Rewards (...) of one control step each: 0 at the goal, negative elsewhere.

    Levels 1 to 3: -e_position, whatever the orientation. Level 4: -½ (e_position + e_orientation), where
    e_orientation is `long_axis_error` for an object with a long axis, else `rotation_error`.

    Args:
        level: 1 to 4.
        goal_position: (..., 3) [m].
        position: (..., 3) [m].
        goal_orientation: (..., 4) xyzw; level 4 needs it, the others ignore it.
        orientation: (..., 4) xyzw; likewise.
        model: the object, whose size says whether it has a long axis; None: it has none.

    Raises:
        TaskError: an argument is missing or malformed, or leading axes do not fit together.
    """
    _check_level(level)
    position_term = position_error(goal_position, position)
    if level < 4:
        return 0.0 - position_term  # a minus sign alone would make 0 negative
    if goal_orientation is None or orientation is None:
        missing = "goal_orientation" if goal_orientation is None else "orientation"
        raise TaskError(f"{missing}: found None, expected a quaternion (x, y, z, w) at level 4")
    axis = None if model is None else long_axis(model)
    if axis is None:
        orientation_term = rotation_error(goal_orientation, orientation)
    else:
        orientation_term = long_axis_error(goal_orientation, orientation, axis=axis)
    check_fit("positions", np.shape(position_term), "orientations", np.shape(orientation_term))
    return 0.0 - (position_term + orientation_term) / 2


def episode_reward(rewards: npt.ArrayLike, *, steps: npt.ArrayLike = 1) -> FloatArray:
    """Cumulative rewards (...) of episodes: the sum over their control steps.

    Args:
        rewards: (..., N) over time.
        steps: number of control steps for which each reward holds, one for all or (..., N): 1 where there is
            one for every step, 100 where poses come at 10 Hz and steps take 1 ms.

    Raises:
        TaskError: an argument is malformed.
    """
    values, counts = numbers("rewards", rewards), numbers("steps", steps, finite=True)
    if values.ndim == 0:
        raise TaskError("rewards: found a single number, expected an array (..., N) over time")
    if (counts < 0).any():
        raise TaskError(f"steps: found {counts.min():g}, expected no negative number")
    try:
        counts = np.broadcast_to(counts, values.shape)
    except ValueError:
        valid = f"one number or {values.shape}"
        raise TaskError(f"steps: found shape {counts.shape}, expected {valid}") from None
    result: FloatArray = np.sum(values * counts, axis=-1)
    return result


def weighted_total(episode_rewards: Mapping[int, npt.ArrayLike], *, median: bool = False) -> float:
    """Total of the Real Robot Challenge: the sum over levels i of i · R_i.

    R_i is the mean of the cumulative rewards of the episodes of level i, as the challenge had it for the
    cube; for the cuboid it took the median, which bears a failed episode better.

    Args:
        episode_rewards: cumulative rewards (N,) of the episodes of each of the levels 1 to 4.
        median: whether R_i is the median.

    Raises:
        TaskError: a level is missing, unknown or without episodes.
    """
    of_kind(median, bool, "median", TaskError)
    if not isinstance(episode_rewards, Mapping) or set(episode_rewards) != set(LEVELS):
        levels = isinstance(episode_rewards, Mapping)
        found = ", ".join(map(shown, episode_rewards)) or "none" if levels else shown(episode_rewards)
        raise TaskError(f"levels of episode rewards: found {found}, expected each of 1, 2, 3, 4")
    total = 0.0
    for level in LEVELS:
        values = numbers(f"episode rewards of level {level}", episode_rewards[level])
        if values.size == 0:
            raise TaskError(f"episode rewards of level {level}: found none, expected at least one")
        total += level * float(np.median(values) if median else np.mean(values))
    return total


def _check_level(level: Any) -> None:
    if not is_whole(level) or level not in LEVELS:
        raise TaskError(f"level: found {shown(level)}, expected 1, 2, 3 or 4")
