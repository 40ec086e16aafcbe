"""Compiled projection: the camera model of tracker.geometry.camera, point by point."""

from collections.abc import Sequence

import numpy as np

from tracker.compiled import compiled
from tracker.conventions import Array
from tracker.geometry import so3
from tracker.geometry.camera import VIEW, Camera, Distortion, bent
from tracker.geometry.cuboid import CORNER_SIGNS
from tracker.geometry.linear import product

LENS = np.dtype(
    [
        ("rotation", np.float64, (3, 3)),  # of camera_from_world
        ("translation", np.float64, (3,)),  # of camera_from_world [m]
        ("position", np.float64, (3,)),  # the camera's centre in the world [m]
        ("focal", np.float64, (2,)),  # fx, fy [px]
        ("center", np.float64, (2,)),  # cx, cy [px]
        ("coefficients", np.float64, (14,)),  # all coefficients, 0 for those not given
        ("tilt", np.float64, (3, 3)),  # homography of the tilted sensor
        ("plain", np.bool_),  # whether only the first five coefficients are not 0
        ("limit", np.float64),  # squared tangent beyond which distortion may fold points back into the image
        ("width", np.int64),  # [px]
        ("height", np.int64),  # [px]
    ]
)
"""A camera as a record: compiled functions read its fields without reference-counting arrays."""


def stack_lenses(cameras: Sequence[Camera]) -> Array:
    """Return the cameras as an array (C,) of LENS records."""
    lenses = np.zeros(len(cameras), LENS)
    for lens, camera in zip(lenses, cameras, strict=True):
        lens["rotation"] = camera.camera_from_world[:3, :3]
        lens["translation"] = camera.camera_from_world[:3, 3]
        lens["position"] = camera.position
        lens["focal"] = camera.matrix[0, 0], camera.matrix[1, 1]
        lens["center"] = camera.matrix[0, 2], camera.matrix[1, 2]
        lens["coefficients"], lens["tilt"], lens["plain"] = Distortion.of(camera.distortion)
        lens["limit"] = (VIEW * camera.largest_tangent) ** 2
        lens["width"], lens["height"] = camera.width, camera.height
    return lenses


@compiled
def project(lenses, c, x, y, z):  # type: ignore[no-untyped-def]
    """Return pixel (u, v) and depth [m] of a world point (x, y, z) in camera c; depth -1 far out of view."""
    lens = lenses[c]
    r, t = lens.rotation, lens.translation
    zc = r[2, 0] * x + r[2, 1] * y + r[2, 2] * z + t[2]
    inverse = 1.0 / max(zc, 1e-6)
    a = (r[0, 0] * x + r[0, 1] * y + r[0, 2] * z + t[0]) * inverse
    b = (r[1, 0] * x + r[1, 1] * y + r[1, 2] * z + t[1]) * inverse
    if a * a + b * b > lens.limit:
        zc = -1.0
    u, v, _, _, _, _ = bent(lens, a, b)
    return lens.focal[0] * u + lens.center[0], lens.focal[1] * v + lens.center[1], zc


@compiled
def may_see(lenses, c, position, radius):  # type: ignore[no-untyped-def]
    """Whether camera c may see a body of a radius [m] at a position (3,) [m]: part of it is in the image."""
    lens = lenses[c]
    u, v, z = project(lenses, c, position[0], position[1], position[2])
    across, down = radius * lens.focal[0], radius * lens.focal[1]
    inside = -across <= u * z <= lens.width * z + across and -down <= v * z <= lens.height * z + down
    return z > 0.0 and inside


@compiled
def project_with_jacobian(lenses, c, x, y, z, jacobian):  # type: ignore[no-untyped-def]
    """Like `project`, but with depth at least 1e-6 [m]; fill jacobian (2, 3) = d(u, v)/d(x, y, z) [px/m]."""
    lens = lenses[c]
    r, t = lens.rotation, lens.translation
    zc = max(r[2, 0] * x + r[2, 1] * y + r[2, 2] * z + t[2], 1e-6)
    inverse = 1.0 / zc
    a = (r[0, 0] * x + r[0, 1] * y + r[0, 2] * z + t[0]) * inverse
    b = (r[1, 0] * x + r[1, 1] * y + r[1, 2] * z + t[1]) * inverse
    u, v, ua, ub, va, vb = bent(lens, a, b)
    for i in range(3):
        da = (r[0, i] - a * r[2, i]) * inverse
        db = (r[1, i] - b * r[2, i]) * inverse
        jacobian[0, i] = lens.focal[0] * (ua * da + ub * db)
        jacobian[1, i] = lens.focal[1] * (va * da + vb * db)
    return lens.focal[0] * u + lens.center[0], lens.focal[1] * v + lens.center[1], zc


@compiled
def project_corners(lenses, c, half, rotation, position, out):  # type: ignore[no-untyped-def]
    """Fill out (8, 3) with pixel and depth, as from `project`, of a box's corners in camera c."""
    r = rotation
    for k in range(8):
        x, y, z = CORNER_SIGNS[k, 0] * half[0], CORNER_SIGNS[k, 1] * half[1], CORNER_SIGNS[k, 2] * half[2]
        out[k, 0], out[k, 1], out[k, 2] = project(
            lenses, c,
            r[0, 0] * x + r[0, 1] * y + r[0, 2] * z + position[0],
            r[1, 0] * x + r[1, 1] * y + r[1, 2] * z + position[1],
            r[2, 0] * x + r[2, 1] * y + r[2, 2] * z + position[2],
        )  # fmt: skip


@compiled
def face_heights(lenses, c, half, rotation, position, out):  # type: ignore[no-untyped-def]
    """Fill out (6,) with the camera's height above each face's plane [m]; positive: it sees the face."""
    for axis in range(3):
        along = 0.0
        for i in range(3):
            along += rotation[i, axis] * (lenses[c].position[i] - position[i])
        out[2 * axis] = along - half[axis]
        out[2 * axis + 1] = -along - half[axis]


@compiled
def copy_pose(rotation, position, new_rotation, new_position):  # type: ignore[no-untyped-def]
    """Copy a pose into other arrays, without shape checks, which take as long to compile as a kernel."""
    for i in range(3):
        new_position[i] = position[i]
        for j in range(3):
            new_rotation[i, j] = rotation[i, j]


@compiled
def apply_update(rotation, position, update):  # type: ignore[no-untyped-def]
    """Move a pose in place by update (6,): p += δp, R = exp(δθ) R."""
    turn, turned = np.empty((3, 3)), np.empty((3, 3))
    so3.exp_into(update[3:6], turn)
    product(turn, rotation, turned)
    for i in range(3):
        position[i] += update[i]
        for k in range(3):
            rotation[i, k] = turned[i, k]


@compiled
def clamped(value, most):  # type: ignore[no-untyped-def]
    """Truncate a coordinate to a whole number, clamped to 0 … `most`; 0 for NaN."""
    return int(min(max(value, 0.0), float(most))) if value == value else 0
