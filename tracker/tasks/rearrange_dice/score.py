"""The task's score: pixels that show dice where there should be none."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import cv2
import numpy as np
import numpy.typing as npt

from tracker.calibration.rig import CameraRig
from tracker.checks import check_sequence, of_kind
from tracker.conventions import Array, FloatArray, Image
from tracker.errors import TaskError
from tracker.geometry import cuboid
from tracker.geometry.camera import Camera
from tracker.tasks.rearrange_dice.goals import DIE_WIDTH, TOLERANCE, finite_positions
from tracker.tasks.rearrange_dice.masks import as_mask

TARGET_WIDTH = DIE_WIDTH + TOLERANCE
"""Edge of the boxes, with faces along the world's axes, in which dice count as placed [m]."""

_BOX = cuboid.corners(np.full(3, TARGET_WIDTH))
_FARTHEST_PX = 2**15  # OpenCV's polygons overflow farther out


def goal_masks(rig: Iterable[Camera], goal: npt.ArrayLike, *, exact: bool = False) -> list[Image]:
    """Where each camera of a rig may see dice: the boxes around the goal's positions, nothing hidden.

    Args:
        rig: the cameras.
        goal: (N, 3) [m] positions in the world; on the platform, N is 25.
        exact: by default, corners are cut to whole pixels and the faces between them filled as the
            platform does it, so that errors can be compared with published ones; the boxes then reach
            on average a pixel too far to the left and up. With `exact`, a pixel is set
            where the ray of its centre, bent by the lens, meets a box.

    Returns:
        Masks (H, W) of the cameras, 255 where dice may be, else 0.

    Raises:
        TaskError: the goal is not N finite positions.
    """
    centers = finite_positions(goal, "goal")
    draw = _exact_mask if exact else _filled_mask
    if not isinstance(rig, CameraRig):
        check_sequence(rig, "rig", TaskError)
    return [draw(of_kind(camera, Camera, "rig: camera", TaskError), centers) for camera in rig]


def error(goal_masks: Sequence[npt.ArrayLike] | Array, dice_masks: Sequence[npt.ArrayLike] | Array) -> int:
    """Number of pixels, over all cameras, that show dice outside the goal; see `error_per_camera`."""
    return sum(error_per_camera(goal_masks, dice_masks))


def reward(goal_masks: Sequence[npt.ArrayLike] | Array, dice_masks: Sequence[npt.ArrayLike] | Array) -> int:
    """The task's reward for one set of images: the negative error."""
    return -error(goal_masks, dice_masks)


def error_per_camera(
    goal_masks: Sequence[npt.ArrayLike] | Array, dice_masks: Sequence[npt.ArrayLike] | Array
) -> tuple[int, ...]:
    """Number of pixels of each camera that show dice outside the goal.

    Args:
        goal_masks: (H, W) of each camera, 0 and 1, 0 and 255, or bool; one stacked array will do.
        dice_masks: the same for the pixels that show dice.

    Raises:
        TaskError: there is no mask, the two do not belong together, or one is not two-valued.
    """
    for what, given in (("goal masks", goal_masks), ("dice masks", dice_masks)):
        check_sequence(given, what, TaskError)
    if len(goal_masks) != len(dice_masks) or not len(goal_masks):
        raise TaskError(
            f"masks: found {len(goal_masks)} of the goal and {len(dice_masks)} of dice, "
            "expected one of each for each camera"
        )
    errors = []
    for index, (goal, dice) in enumerate(zip(goal_masks, dice_masks, strict=True)):
        wanted, seen = as_mask(goal, f"goal mask {index}"), as_mask(dice, f"dice mask {index}")
        if wanted.shape != seen.shape:
            raise TaskError(
                f"dice mask {index}: found shape {seen.shape}, expected the goal's {wanted.shape}"
            )
        # 1 and 255 have a bit in common, so masks of either kind go together.
        errors.append(cv2.countNonZero(seen) - cv2.countNonZero(cv2.bitwise_and(seen, wanted)))
    return tuple(errors)


def _box_pixels(camera: Camera, centers: FloatArray) -> FloatArray:
    """Pixels (N, 8, 2) of the corners of the boxes at `centers` (N, 3) [m]; NaN out of view."""
    corners = (centers[:, None] + _BOX).reshape(-1, 3)
    return camera.project_in_view(corners).reshape(-1, 8, 2)


def _filled_mask(camera: Camera, centers: FloatArray) -> Image:
    mask: Image = np.zeros((camera.height, camera.width), np.uint8)
    faces = _box_pixels(camera, centers)[:, cuboid.FACE_CORNERS].reshape(-1, 4, 2)
    drawable = (np.abs(faces) < _FARTHEST_PX).all(axis=(1, 2))
    for face in faces[drawable].astype(np.int32):
        cv2.fillConvexPoly(mask, face, 255)
    return mask


def _exact_mask(camera: Camera, centers: FloatArray) -> Image:
    mask: Image = np.zeros((camera.height, camera.width), np.uint8)
    parts = [_part(camera, pixels) for pixels in _box_pixels(camera, centers)]
    needed = np.zeros(mask.shape, np.bool_)
    for part in parts:
        needed[part] = True
    rows, columns = np.nonzero(needed)
    inverse = np.full((3, *mask.shape), np.nan)
    with np.errstate(divide="ignore"):  # a ray along a face has an infinite inverse
        inverse[:, rows, columns] = 1 / camera.rays(np.stack([columns, rows], axis=1)).T
    for center, part in zip(centers, parts, strict=True):
        mask[part][_meets_box(inverse[:, part[0], part[1]], center - camera.position)] = 255
    return mask


def _part(camera: Camera, pixels: FloatArray) -> tuple[slice, slice]:
    """Rows and columns of the image that hold the box of these corners (8, 2) [px]."""
    if not (np.abs(pixels) < _FARTHEST_PX).all():
        return slice(0, camera.height), slice(0, camera.width)
    # The lens bends the edges outwards between the corners.
    margin = 2 + 0.1 * np.ptp(pixels, axis=0)
    left, top = np.clip(np.floor(pixels.min(axis=0) - margin), 0, (camera.width, camera.height)).astype(int)
    right, bottom = np.clip(
        np.ceil(pixels.max(axis=0) + margin) + 1, 0, (camera.width, camera.height)
    ).astype(int)
    return slice(top, bottom), slice(left, right)


def _meets_box(inverse: FloatArray, center: FloatArray) -> Array:
    """Which rays from the origin with 1/direction `inverse` (3, H, W) meet the box at `center` (3,) [m].

    A ray is inside the box where it is between each of the three pairs of parallel planes.
    """
    low, high = (
        (center + offset)[:, None, None] * inverse for offset in (-TARGET_WIDTH / 2, TARGET_WIDTH / 2)
    )
    enters = np.fmax.reduce(np.fmin(low, high), axis=0)
    leaves = np.fmin.reduce(np.fmax(low, high), axis=0)
    return np.asarray((enters <= leaves) & (leaves > 0))
