"""How far positions and orientations are from their goals, as shares of the largest distances."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from tracker.checks import is_whole
from tracker.conventions import FloatArray
from tracker.errors import TaskError, shown
from tracker.geometry import so3
from tracker.tasks.move_object.checks import pair, quaternions

XY_RANGE = 0.39
"""Largest horizontal distance of two places: the arena's diameter [m]."""

Z_RANGE = 0.1
"""Height of the goals' space [m]."""


def position_error(goal_position: npt.ArrayLike, position: npt.ArrayLike) -> FloatArray:
    """Errors (...) of positions: ½ (‖Δxy‖ / 0.39 m + |Δz| / 0.1 m), about 1 at most.

    Args:
        goal_position: (..., 3) [m].
        position: (..., 3) [m].

    Raises:
        TaskError: an argument is malformed, or their leading axes do not fit together.
    """
    goal, actual = pair("position", 3, goal_position, position)
    difference = actual - goal
    across = np.linalg.norm(difference[..., :2], axis=-1)
    result: FloatArray = (across / XY_RANGE + np.abs(difference[..., 2]) / Z_RANGE) / 2
    return result


def rotation_error(goal_orientation: npt.ArrayLike, orientation: npt.ArrayLike) -> FloatArray:
    """Errors (...) in [0, 1] of orientations: the angle of the rotation between the two, divided by π.

    Args:
        goal_orientation: (..., 4) xyzw.
        orientation: (..., 4) xyzw.

    Raises:
        TaskError: an argument is malformed, or their leading axes do not fit together.
    """
    goal, actual = quaternions(goal_orientation, orientation)
    # Vector and scalar of goal⁻¹ · actual; exactly 0 where the two are equal.
    vector = goal[..., 3:] * actual[..., :3] - actual[..., 3:] * goal[..., :3]
    vector = vector - np.cross(goal[..., :3], actual[..., :3])
    scalar = np.sum(goal * actual, axis=-1)
    result: FloatArray = 2 * np.arctan2(np.linalg.norm(vector, axis=-1), np.abs(scalar)) / np.pi
    return result


def long_axis_error(
    goal_orientation: npt.ArrayLike, orientation: npt.ArrayLike, *, axis: int = 1
) -> FloatArray:
    """Errors (...) in [0, 1] of the direction of one axis of the object: the angle, divided by π.

    A turn about that axis costs nothing, a flip costs 1. The angle is exact to rounding. The platform's
    package takes the arccosine of a cosine that it rounds to ten digits: it differs by up to 5e-11 rad over
    the sine of the angle, and by up to 1e-5 rad near 0 and π.

    Args:
        goal_orientation: (..., 4) xyzw.
        orientation: (..., 4) xyzw.
        axis: 0, 1 or 2: the object's x, y or z.

    Raises:
        TaskError: an argument is malformed, or their leading axes do not fit together.
    """
    if not is_whole(axis) or axis not in (0, 1, 2):
        raise TaskError(f"axis: found {shown(axis)}, expected 0, 1 or 2")
    goal, actual = (
        so3.matrix_from_quaternion(one)[..., axis] for one in quaternions(goal_orientation, orientation)
    )
    sine = np.linalg.norm(np.cross(goal, actual), axis=-1)
    result: FloatArray = np.arctan2(sine, np.sum(goal * actual, axis=-1)) / np.pi
    return result
