"""How far an estimated pose is from the true one. All functions take stacks of poses.

Poses are positions (N, 3) [m] and rotations (N, 3, 3) world from object; cuboids have no symmetries, since
their six faces have six colours.
"""

from __future__ import annotations

from collections.abc import Iterable

import cv2
import numpy as np

from tracker.conventions import Array, FloatArray
from tracker.geometry import so3
from tracker.geometry.camera import Camera
from tracker.geometry.cuboid import corners
from tracker.pose.result import PoseEstimate
from tracker.tasks import move_object

Pose = tuple[Array, Array]
"""Positions (N, 3) [m] and rotations (N, 3, 3)."""


GRID = 7
"""Points along each edge of a face, for the mean over the surface."""


def diameter(size: Array) -> float:
    """Greatest distance [m] of two points of a cuboid of edge lengths `size` (3,) [m]."""
    return float(np.linalg.norm(size))


def surface_points(size: Array) -> FloatArray:
    """Points (M, 3) [m] on an even grid over the surface, in the object's frame, each once."""
    steps = np.linspace(-0.5, 0.5, GRID)
    grid = np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3)
    result: FloatArray = grid[(np.abs(grid) == 0.5).any(axis=1)] * np.asarray(size)
    return result


def longest_axis(size: Array) -> int | None:
    """Number of the longest edge's axis; None where several are about as long."""
    order = np.argsort(size)
    return int(order[2]) if size[order[2]] > 1.2 * size[order[1]] else None


def position_error(true: Array, found: Array) -> FloatArray:
    """Distances (N,) [m] of positions (N, 3)."""
    result: FloatArray = np.linalg.norm(np.asarray(found) - np.asarray(true), axis=-1)
    return result


def rotation_error(true: Array, found: Array) -> FloatArray:
    """Angles (N,) [rad] in [0, π] between rotations (N, 3, 3)."""
    return so3.angle_between(true, found)


def axis_error(true: Array, found: Array, axis: int) -> FloatArray:
    """Angles (N,) [rad] in [0, π] between the directions of one of the object's axes."""
    a, b = np.asarray(true)[..., axis], np.asarray(found)[..., axis]
    # Half-angle formula: exact where the cosine is flat.
    result: FloatArray = 2 * np.arctan2(np.linalg.norm(a - b, axis=-1), np.linalg.norm(a + b, axis=-1))
    return result


def roll_error(true: Array, found: Array, axis: int) -> FloatArray:
    """Angles (N,) [rad] in [0, π] of the part of the rotation between the two that is about an axis.

    The rotation is a turn about the axis followed by one about an axis that is normal to it.
    """
    relative = np.swapaxes(np.asarray(true), -1, -2) @ np.asarray(found)
    q = so3.quaternion_from_matrix(relative)
    result: FloatArray = 2 * np.arctan2(np.abs(q[..., axis]), np.abs(q[..., 3]))
    return result


def surface_error(size: Array, true: Pose, found: Pose) -> tuple[FloatArray, FloatArray]:
    """Mean and greatest distance (N,) [m] of the surface's points: ADD and MSSD, without symmetries."""
    # The greatest is at a corner, which the grid holds.
    points = surface_points(size)
    apart = np.linalg.norm(placed(points, *true) - placed(points, *found), axis=-1)
    return apart.mean(axis=-1), apart.max(axis=-1)


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


def image_error(size: Array, cameras: Iterable[Camera], true: Pose, found: Pose) -> FloatArray:
    """Greatest distance (N,) [px] of the projected corners, in the worst camera: MSPD, no symmetries."""
    points = corners(np.asarray(size))
    a, b = placed(points, *true), placed(points, *found)
    worst = []
    for camera in cameras:
        apart = projected(camera, a.reshape(-1, 3)) - projected(camera, b.reshape(-1, 3))
        worst.append(np.linalg.norm(apart, axis=-1).reshape(a.shape[:-1]).max(axis=-1))
    result: FloatArray = np.max(worst, axis=0)
    return result


def nees(true: Pose, found: Pose, covariance: Array) -> FloatArray:
    """Normalised estimation error squared (N,): dᵀ Σ⁻¹ d.

    d = (p_true - p̂, log(R_true R̂ᵀ)) and Σ (N, 6, 6) are along world axes [m, rad]. For a true covariance
    it is distributed as χ² with 6 degrees of freedom, whose median is 5.35.
    """
    turn = so3.log(np.asarray(true[1]) @ np.swapaxes(found[1], -1, -2))
    d = np.concatenate([np.asarray(true[0]) - np.asarray(found[0]), turn], axis=-1)
    result: FloatArray = np.einsum("...i,...i->...", d, np.linalg.solve(covariance, d[..., None])[..., 0])
    return result


def pose_errors(pose: PoseEstimate | None, true: Array) -> tuple[float, float, float]:
    """Distance [mm], angle [°] and NEES [1] of a pose from the true one (3, 4); nan where one is missing."""
    if pose is None or not np.isfinite(true).all():
        return np.nan, np.nan, np.nan
    exact = true[:, 3], true[:, :3]
    found = pose.position, so3.matrix_from_quaternion(pose.orientation)
    return (
        1e3 * float(position_error(exact[0], found[0])),
        float(np.degrees(rotation_error(exact[1], found[1]))),
        float(nees(exact, found, pose.covariance)),
    )


def task_errors(size: Array, true: Pose, found: Pose) -> tuple[FloatArray, FloatArray]:
    """Errors of position and of rotation (N,) [1] by which the tasks reward.

    Of a cuboid with a longest axis, rotation means that axis alone.
    """
    position = move_object.position_error(true[0], found[0])
    axis = longest_axis(size)
    turn = rotation_error(true[1], found[1]) if axis is None else axis_error(true[1], found[1], axis)
    return position, turn / np.pi
