"""An object's corners in place of its pose, in the order of the platform's data sets."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from tracker.checks import is_number
from tracker.conventions import FloatArray
from tracker.errors import TaskError, shown
from tracker.geometry import cuboid, so3
from tracker.tasks.checks import check_fit, numbers, quaternion, vectors


def keypoints(position: npt.ArrayLike, orientation: npt.ArrayLike, size: npt.ArrayLike) -> FloatArray:
    """Corners (..., 8, 3) [m] in the world of a box.

    Corner i is on the + side of the object's x, y, z where bit 0, 1, 2 of i is 0.

    Args:
        position: (..., 3) of the box's centre [m]; NaN where it was not seen gives NaN.
        orientation: (..., 4) xyzw.
        size: (3,) edge lengths [m], as a model's `size`.

    Raises:
        TaskError: an argument is malformed, or their leading axes do not fit together.
    """
    places, turns = vectors("position", 3, position), quaternion("orientation", orientation)
    check_fit("position", places.shape[:-1], "orientation", turns.shape[:-1])
    return cuboid.keypoints(places, so3.matrix_from_quaternion(turns), _size(size))


def pose_from_keypoints(
    corners: npt.ArrayLike, size: npt.ArrayLike, *, tolerance: float = 1e-3
) -> tuple[FloatArray, FloatArray]:
    """Position (..., 3) [m] and orientation (..., 4) xyzw of the box that has these corners.

    The rotation is that of the least squares over all corners (Kabsch); the orientation's w is not negative.

    Args:
        corners: (..., 8, 3) [m] in the order of `keypoints`; NaN where it was not seen gives NaN.
        size: (3,) edge lengths [m].
        tolerance: largest distance [m] of a corner from that of the box.

    Raises:
        TaskError: an argument is malformed, or the corners are not those of a box of this size: one is
            farther away than `tolerance`, or they are in another order.
    """
    if not is_number(tolerance):
        raise TaskError(f"tolerance: found {shown(tolerance)}, expected a finite distance [m]")
    found, edges = numbers("keypoints", corners), _size(size)
    if found.shape[-2:] != (8, 3):
        raise TaskError(f"keypoints: found shape {found.shape}, expected (..., 8, 3)")
    unseen = np.isnan(found.sum(axis=(-2, -1), keepdims=True))
    # Anything that can be decomposed stands in for what was not seen.
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
