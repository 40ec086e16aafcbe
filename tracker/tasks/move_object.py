"""Errors and rewards of the platform's tasks that move an object: to a goal, or along a trajectory of goals.

Positions are those of the object's centre in the world [m]. Orientations are quaternions (x, y, z, w) of any
nonzero length. Lists, as in a goal's JSON file, work as well as arrays. Every function takes one state or
many, for instance a whole episode: leading axes broadcast.

Goals must be finite. A state may be NaN where the object was not seen; its error and reward are NaN, too.
Every function raises a TaskError if an argument is missing or malformed, or if leading axes do not broadcast.
"""

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from tracker.checks import check_sequence, is_number, is_whole, of_kind
from tracker.conventions import FloatArray
from tracker.errors import TaskError, shown
from tracker.geometry import cuboid, so3
from tracker.objects.model import CuboidModel
from tracker.tasks.checks import check_fit, numbers, pair, quaternions, vectors

_XY_RANGE = 0.39
"""Largest horizontal distance of two positions: the arena's diameter [m]."""

_Z_RANGE = 0.1
"""Height of the space that contains all goals [m]."""

LEVELS = (1, 2, 3, 4)
"""Levels of difficulty: on the table, lifted, anywhere in the air; 4 with an orientation."""

_LONG = 2.0
"""An object has a long axis if its longest edge is at least this many times as long as the next."""

Trajectory = Sequence[tuple[float, npt.ArrayLike]]
"""Pairs of the time at which a goal becomes active, and its position (3,) [m]."""


def position_error(goal_position: npt.ArrayLike, position: npt.ArrayLike) -> FloatArray:
    """Return errors (...) of positions (..., 3) [m]: ½ (‖Δxy‖ / 0.39 m + |Δz| / 0.1 m), at most about 1."""
    goal, actual = pair("position", vectors, goal_position, position)
    difference = actual - goal
    across = np.linalg.norm(difference[..., :2], axis=-1)
    result: FloatArray = (across / _XY_RANGE + np.abs(difference[..., 2]) / _Z_RANGE) / 2
    return result


def rotation_error(goal_orientation: npt.ArrayLike, orientation: npt.ArrayLike) -> FloatArray:
    """Return errors (...) in [0, 1] of orientations (..., 4) xyzw: the angle between them, divided by π."""
    goal, actual = pair("orientation", quaternions, goal_orientation, orientation)
    # Vector and scalar parts of goal⁻¹ · actual; the vector is exactly 0 if the two are equal.
    vector = goal[..., 3:] * actual[..., :3] - actual[..., 3:] * goal[..., :3]
    vector = vector - np.cross(goal[..., :3], actual[..., :3])
    scalar = np.sum(goal * actual, axis=-1)
    result: FloatArray = 2 * np.arctan2(np.linalg.norm(vector, axis=-1), np.abs(scalar)) / np.pi
    return result


def long_axis_error(
    goal_orientation: npt.ArrayLike, orientation: npt.ArrayLike, *, axis: int = 1
) -> FloatArray:
    """Return errors (...) in [0, 1] in the direction of one axis of the object: the angle, divided by π.

    Turning about that axis costs nothing; a flip costs 1. The angle is exact up to rounding. The platform's
    package takes the arccosine of a cosine rounded to ten digits, so its angle differs by up to 5e-11 rad
    divided by the sine of the angle, and by up to 1e-5 rad near 0 and π.

    Args:
        goal_orientation: (..., 4) xyzw.
        orientation: (..., 4) xyzw.
        axis: 0, 1 or 2 for the object's x, y or z.
    """
    if not is_whole(axis) or axis not in (0, 1, 2):
        raise TaskError(f"axis: found {shown(axis)}, expected 0, 1 or 2")
    turns = pair("orientation", quaternions, goal_orientation, orientation)
    goal, actual = (so3.matrix_from_quaternion(one)[..., axis] for one in turns)
    sine = np.linalg.norm(np.cross(goal, actual), axis=-1)
    result: FloatArray = np.arctan2(sine, np.sum(goal * actual, axis=-1)) / np.pi
    return result


def long_axis(model: CuboidModel) -> int | None:
    """Return the object's long axis (0, 1 or 2), at least twice as long as the others; None without one."""
    of_kind(model, CuboidModel, "model", TaskError, "tracker.load_object")
    shorter, longest = np.sort(model.size)[1:]
    return int(np.argmax(model.size)) if longest >= _LONG * shorter else None


def reward(
    level: int,
    goal_position: npt.ArrayLike,
    position: npt.ArrayLike,
    goal_orientation: npt.ArrayLike | None = None,
    orientation: npt.ArrayLike | None = None,
    *,
    model: CuboidModel | None = None,
) -> FloatArray:
    """Return rewards (...) per control step: 0 at the goal, negative elsewhere.

    Levels 1 to 3: -e_position; the orientation does not count. Level 4: -½ (e_position + e_orientation),
    where e_orientation is `long_axis_error` for an object with a long axis, else `rotation_error`.

    Args:
        level: 1 to 4.
        goal_position: (..., 3) [m].
        position: (..., 3) [m].
        goal_orientation: (..., 4) xyzw; level 4 needs it, the others ignore it.
        orientation: (..., 4) xyzw; likewise.
        model: the object, whose size determines whether it has a long axis; None: it has none.
    """
    if not is_whole(level) or level not in LEVELS:
        raise TaskError(f"level: found {shown(level)}, expected 1, 2, 3 or 4")
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
    """Return cumulative rewards (...) of episodes: the sum over their control steps.

    Args:
        rewards: (..., N) over time.
        steps: number of control steps that each reward covers, a scalar or (..., N): 1 if there is a reward
            for every step, 100 if poses come at 10 Hz and steps take 1 ms.
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
    """Return the total of the Real Robot Challenge: the sum over levels i of i · R_i.

    R_i is the mean cumulative reward of the episodes of level i, as in the challenge with the cube. With
    the cuboid it was the median, which is less sensitive to failed episodes.

    Args:
        episode_rewards: cumulative rewards (N,) of the episodes of each level from 1 to 4.
        median: whether R_i is the median instead of the mean.

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


def active_goal(trajectory: Trajectory, time: npt.ArrayLike) -> FloatArray:
    """Return goals (..., 3) [m] active at times (...); each lasts until the next begins, the last forever.

    Args:
        trajectory: pairs (time, position), e.g. [(0, (0, 0, 0.05)), (30000, (0.1, 0, 0.08))]; the first
            begins at 0.
        time: in the trajectory's unit; control steps of 1 ms on the platform.

    Raises:
        TaskError: the trajectory is malformed, or a time is before its beginning.
    """
    check_sequence(trajectory, "trajectory", TaskError, "a list of pairs (time, position)")
    if len(trajectory) == 0:
        raise TaskError("trajectory: found no goals, expected at least one")
    times, positions = np.empty(len(trajectory)), np.empty((len(trajectory), 3))
    for k, entry in enumerate(trajectory):
        if not isinstance(entry, (tuple, list)) or len(entry) != 2:
            raise TaskError(f"trajectory: entry {k}: found {shown(entry)}, expected a pair (time, position)")
        begin = numbers(f"trajectory: time {k}", entry[0], finite=True)
        goal = numbers(f"trajectory: position {k}", entry[1], finite=True)
        if begin.ndim or goal.shape != (3,):
            raise TaskError(f"trajectory: entry {k}: found {shown(entry)}, expected a number and 3 numbers")
        times[k], positions[k] = begin, goal
    if times[0] != 0:
        raise TaskError(f"trajectory: found {times[0]:g} as the first time, expected 0")
    late = np.flatnonzero(np.diff(times) <= 0)
    if late.size:
        k = int(late[0]) + 1
        raise TaskError(f"trajectory: time {k}: found {times[k]:g}, expected more than {times[k - 1]:g}")
    at = numbers("time", time, finite=True)
    if (at < 0).any():
        raise TaskError(f"time: found {at.min():g}, expected no time before the trajectory's beginning at 0")
    return positions[np.searchsorted(times, at, side="right") - 1]


def trajectory_reward(trajectory: Trajectory, time: npt.ArrayLike, position: npt.ArrayLike) -> FloatArray:
    """Return rewards (...) per control step: -e_position with respect to the goal active at times (...).

    Positions are (..., 3) [m]; trajectory and times as for `active_goal`.
    """
    return 0.0 - position_error(active_goal(trajectory, time), position)


def keypoints(position: npt.ArrayLike, orientation: npt.ArrayLike, size: npt.ArrayLike) -> FloatArray:
    """Return the corners (..., 8, 3) [m] of a box in the world.

    Corner i is on the + side of the object's x, y, z if bit 0, 1, 2 of i is 0.

    Args:
        position: (..., 3) of the box's centre [m]; NaN if it was not seen, which gives NaN.
        orientation: (..., 4) xyzw.
        size: (3,) edge lengths [m], as a model's `size`.
    """
    places, turns = vectors("position", position), quaternions("orientation", orientation)
    check_fit("position", places.shape[:-1], "orientation", turns.shape[:-1])
    return cuboid.keypoints(places, so3.matrix_from_quaternion(turns), _size(size))


def pose_from_keypoints(
    corners: npt.ArrayLike, size: npt.ArrayLike, *, tolerance: float = 1e-3
) -> tuple[FloatArray, FloatArray]:
    """Return position (..., 3) [m] and orientation (..., 4) xyzw of the box with these corners.

    The rotation is the least-squares solution over all corners (Kabsch); the orientation has w ≥ 0.

    Args:
        corners: (..., 8, 3) [m] in the order of `keypoints`; NaN if it was not seen, which gives NaN.
        size: (3,) edge lengths [m].
        tolerance: largest distance between a corner and that of the fitted box [m].

    Raises:
        TaskError: an argument is malformed, or the corners are not those of a box of this size: one is
            farther away than `tolerance`, or they are in another order.
    """
    if not is_number(tolerance) or tolerance < 0:
        raise TaskError(f"tolerance: found {shown(tolerance)}, expected a finite distance [m], not negative")
    found, edges = numbers("keypoints", corners), _size(size)
    if found.shape[-2:] != (8, 3):
        raise TaskError(f"keypoints: found shape {found.shape}, expected (..., 8, 3)")
    unseen = np.isnan(found.sum(axis=(-2, -1), keepdims=True))
    # Replace unseen corners with values for which the singular value decomposition works.
    seen = np.where(unseen, cuboid.keypoints(np.zeros(3), np.eye(3), edges), found)
    position = seen.mean(axis=-2)
    inside = cuboid.KEYPOINT_SIGNS * (edges / 2)
    rotation = so3.nearest_rotation(np.swapaxes(seen - position[..., None, :], -1, -2) @ inside)
    off = np.linalg.norm(seen - cuboid.keypoints(position, rotation, edges), axis=-1).max(initial=0)
    if not off <= tolerance:
        size_mm = "×".join(f"{1e3 * edge:g}" for edge in edges)
        raise TaskError(
            f"keypoints: found a corner {1e3 * off:.3g} mm from that of a box of {size_mm} mm, expected at "
            f"most {1e3 * tolerance:g} mm, corner i on the + side of x, y, z where bit 0, 1, 2 of i is 0"
        )
    orientation = so3.quaternion_from_matrix(rotation)
    nan = unseen[..., 0]
    return np.where(nan, np.nan, position), np.where(nan, np.nan, orientation)


def _size(size: npt.ArrayLike) -> FloatArray:
    edges = numbers("size", size, finite=True)
    if edges.shape != (3,) or edges.min() <= 0:
        raise TaskError(f"size: found {shown(size)}, expected three lengths above 0 m")
    return edges
