"""How far an estimated pose is from the true one.

Poses are positions (..., 3) [m] and rotations (..., 3, 3) world from object; cuboids have no symmetries,
since their six faces have six colours.
"""

from __future__ import annotations

import cv2
import numpy as np

from tracker.conventions import Array, FloatArray
from tracker.geometry import so3
from tracker.geometry.camera import Camera
from tracker.pose.result import PoseEstimate

UNITS = ("mm", "deg", "nees")
"""Of what `pose_errors` gives."""


def longest_axis(size: Array) -> int | None:
    """Number of the longest edge's axis; None where several are about as long."""
    order = np.argsort(size)
    return int(order[2]) if size[order[2]] > 1.2 * size[order[1]] else None


def roll_error(true: Array, found: Array, axis: int) -> FloatArray:
    """Angles (N,) [rad] in [0, π] of the part of the rotation between the two that is about an axis.

    The rotation is a turn about the axis followed by one about an axis that is normal to it.
    """
    relative = np.swapaxes(np.asarray(true), -1, -2) @ np.asarray(found)
    q = so3.quaternion_from_matrix(relative)
    result: FloatArray = 2 * np.arctan2(np.abs(q[..., axis]), np.abs(q[..., 3]))
    return result


def placed(points: Array, position: Array, rotation: Array) -> FloatArray:
    """Points (..., M, 3) [m] of the object in the world, at each of the poses."""
    result: FloatArray = points @ np.swapaxes(rotation, -1, -2) + np.asarray(position)[..., None, :]
    return result


def projected(camera: Camera, points: Array) -> FloatArray:
    """Pixels (M, 2) of world points (M, 3) [m] by OpenCV, which shares no code with the tracker."""
    turn, shift = camera.camera_from_world[:3, :3], camera.camera_from_world[:3, 3]
    pixels, _ = cv2.projectPoints(
        np.ascontiguousarray(points, dtype=np.float64),
        cv2.Rodrigues(turn)[0],
        shift,
        camera.matrix,
        camera.distortion,
    )
    return np.asarray(pixels[:, 0], dtype=np.float64)


def nees(true: tuple[Array, Array], found: tuple[Array, Array], covariance: Array) -> FloatArray:
    """Normalised estimation error squared (...): dᵀ Σ⁻¹ d.

    d = (p_true - p̂, log(R_true R̂ᵀ)) and Σ (..., 6, 6) are along world axes [m, rad]. For a true covariance
    it is distributed as χ² with 6 degrees of freedom, whose median is 5.35.
    """
    turn = so3.log(np.asarray(true[1]) @ np.swapaxes(found[1], -1, -2))
    d = np.concatenate([np.asarray(true[0]) - np.asarray(found[0]), turn], axis=-1)
    result: FloatArray = np.einsum("...i,...i->...", d, np.linalg.solve(covariance, d[..., None])[..., 0])
    return result


def apart(one: PoseEstimate | None, other: PoseEstimate | None) -> tuple[float, float]:
    """Distance [mm] and angle [°] of two poses; nan where one is missing."""
    if one is None or other is None:
        return np.nan, np.nan
    shift = 1e3 * float(np.linalg.norm(one.position - other.position))
    return shift, float(np.degrees(so3.angle_between(one.rotation, other.rotation)))


def pose_errors(pose: PoseEstimate | None, true: Array) -> tuple[float, float, float]:
    """Distance [mm], angle [°] and NEES [1] of a pose from the true one (3, 4); nan where one is missing."""
    if pose is None or not np.isfinite(true).all():
        return np.nan, np.nan, np.nan
    exact = true[:, 3], true[:, :3]
    found = pose.position, so3.matrix_from_quaternion(pose.orientation)
    return (
        1e3 * float(np.linalg.norm(exact[0] - found[0])),
        float(np.degrees(so3.angle_between(exact[1], found[1]))),
        float(nees(exact, found, pose.covariance)),
    )


def true_pose(position: Array | None, rotation: Array | None) -> FloatArray:
    """(3, 4) rotation and position; nan where there is no object."""
    if position is None or rotation is None:
        return np.full((3, 4), np.nan)
    return np.column_stack([rotation, position])
