"""Errors of an estimated pose.

Poses are positions (..., 3) [m] and rotations (..., 3, 3) world_from_object. Cuboids have no symmetry, since
their six faces have six colours.
"""

import cv2
import numpy as np

from tracker.conventions import Array, FloatArray
from tracker.geometry import so3
from tracker.geometry.camera import Camera
from tracker.pose.result import PoseEstimate


def longest_axis(size: Array) -> int | None:
    """Return the index of the longest edge's axis; None if several are about as long."""
    order = np.argsort(size)
    return int(order[2]) if size[order[2]] > 1.2 * size[order[1]] else None


def roll_error(true: Array, found: Array, axis: int) -> FloatArray:
    """Return angles (N,) [rad] in [0, π]: the relative rotation's component about an axis (0, 1 or 2).

    The relative rotation is split into a rotation about the axis and one about a normal to it.
    """
    relative = np.swapaxes(np.asarray(true), -1, -2) @ np.asarray(found)
    q = so3.quaternion_from_matrix(relative)
    result: FloatArray = 2 * np.arctan2(np.abs(q[..., axis]), np.abs(q[..., 3]))
    return result


def placed(points: Array, position: Array, rotation: Array) -> FloatArray:
    """Transform points (..., M, 3) [m] from the object to the world, for each pose."""
    result: FloatArray = points @ np.swapaxes(rotation, -1, -2) + np.asarray(position)[..., None, :]
    return result


def projected(camera: Camera, points: Array) -> FloatArray:
    """Project world points (M, 3) [m] to pixels (M, 2) by OpenCV, which shares no code with the tracker."""
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
    """Return the normalised estimation error squared (...): dᵀ Σ⁻¹ d.

    d = (p_true - p̂, log(R_true R̂ᵀ)) and Σ (..., 6, 6) are along world axes [m, rad]. If the covariance is
    right, its distribution is χ² with 6 degrees of freedom, whose median is 5.35.
    """
    turn = so3.log(np.asarray(true[1]) @ np.swapaxes(found[1], -1, -2))
    d = np.concatenate([np.asarray(true[0]) - np.asarray(found[0]), turn], axis=-1)
    result: FloatArray = np.einsum("...i,...i->...", d, np.linalg.solve(covariance, d[..., None])[..., 0])
    return result


def apart(one: PoseEstimate | None, other: PoseEstimate | None) -> tuple[float, float]:
    """Return distance [mm] and angle [°] between two poses; nan if one is missing."""
    if one is None or other is None:
        return np.nan, np.nan
    shift = 1e3 * float(np.linalg.norm(one.position - other.position))
    return shift, float(np.degrees(so3.angle_between(one.rotation, other.rotation)))


def pose_errors(pose: PoseEstimate | None, true: Array, prefix: str = "") -> dict[str, float]:
    """Return `mm`, `deg` and `nees` of a pose against the true one (3, 4), after a prefix; nan if missing."""
    errors = np.full(3, np.nan)
    if pose is not None and np.isfinite(true).all():
        exact = true[:, 3], true[:, :3]
        found = pose.position, so3.matrix_from_quaternion(pose.orientation)
        errors[0] = 1e3 * np.linalg.norm(exact[0] - found[0])
        errors[1] = np.degrees(so3.angle_between(exact[1], found[1]))
        errors[2] = nees(exact, found, pose.covariance)
    return dict(zip((f"{prefix}mm", f"{prefix}deg", f"{prefix}nees"), errors.tolist(), strict=True))


def true_pose(position: Array | None, rotation: Array | None) -> FloatArray:
    """Return rotation and position (3, 4); nan if there is no object."""
    if position is None or rotation is None:
        return np.full((3, 4), np.nan)
    return np.column_stack([rotation, position])
