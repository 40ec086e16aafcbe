"""A goal that changes with time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from tracker.checks import check_sequence
from tracker.conventions import FloatArray
from tracker.errors import TaskError, shown
from tracker.tasks.move_object.checks import numbers
from tracker.tasks.move_object.errors import position_error

Trajectory = Sequence[tuple[float, npt.ArrayLike]]
"""Pairs of the time from which a goal is active, and its position (3,) [m]."""


def active_goal(trajectory: Trajectory, time: npt.ArrayLike) -> FloatArray:
    """Goals (..., 3) [m] that are active at times (...); each lasts until the next begins, the last for ever.

    Args:
        trajectory: pairs (time, position), e.g. [(0, (0, 0, 0.05)), (30000, (0.1, 0, 0.08))]; the first
            begins at 0.
        time: in the trajectory's unit; on the platform control steps of 1 ms.

    Raises:
        TaskError: the trajectory is malformed, or a time is before its beginning.
    """
    times, positions = _parsed(trajectory)
    at = numbers("time", time, finite=True)
    if (at < 0).any():
        raise TaskError(f"time: found {at.min():g}, expected no time before the trajectory's beginning at 0")
    result: FloatArray = positions[np.searchsorted(times, at, side="right") - 1]
    return result


def trajectory_reward(trajectory: Trajectory, time: npt.ArrayLike, position: npt.ArrayLike) -> FloatArray:
    """Rewards (...) of one control step each: -e_position to the goals that are active at the times.

    Args:
        trajectory: see `active_goal`.
        time: (...) in the trajectory's unit.
        position: (..., 3) [m].

    Raises:
        TaskError: as `active_goal` and `position_error`.
    """
    return 0.0 - position_error(active_goal(trajectory, time), position)


def _parsed(trajectory: Trajectory) -> tuple[FloatArray, FloatArray]:
    """Times (N,) and positions (N, 3) of a trajectory that has been checked."""
    check_sequence(trajectory, "trajectory", TaskError, "a list of pairs (time, position)")
    if len(trajectory) == 0:
        raise TaskError("trajectory: found no goals, expected at least one")
    times, positions = np.empty(len(trajectory)), np.empty((len(trajectory), 3))
    for k, entry in enumerate(trajectory):
        if not isinstance(entry, (tuple, list)) or len(entry) != 2:
            raise TaskError(f"trajectory: entry {k}: found {shown(entry)}, expected a pair (time, position)")
        time, goal = (
            numbers(f"trajectory: {what} {k}", value, finite=True)
            for what, value in zip(("time", "position"), entry, strict=True)
        )
        if time.ndim or goal.shape != (3,):
            raise TaskError(f"trajectory: entry {k}: found {shown(entry)}, expected a number and 3 numbers")
        times[k], positions[k] = time, goal
    if times[0] != 0:
        raise TaskError(f"trajectory: found {times[0]:g} as the first time, expected 0")
    late = np.flatnonzero(np.diff(times) <= 0)
    if late.size:
        k = int(late[0]) + 1
        raise TaskError(f"trajectory: time {k}: found {times[k]:g}, expected more than {times[k - 1]:g}")
    return times, positions
