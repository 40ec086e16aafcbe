"""The task's error (the number of pixels that show dice outside the goal); assignment of dice to places."""

import dataclasses
from collections.abc import Sequence
from typing import TypeAlias

import cv2
import numpy as np
import numpy.typing as npt

from tracker.calibration.rig import CameraRig
from tracker.checks import Frozen, array_of, check_sequence, freeze, is_number, of_kind
from tracker.conventions import Array, FloatArray, Image
from tracker.errors import TaskError, shown
from tracker.geometry import cuboid
from tracker.geometry.camera import Camera
from tracker.tasks.rearrange_dice.goals import DIE_WIDTH, TOLERANCE, finite_positions

TARGET_WIDTH = DIE_WIDTH + TOLERANCE
"""Edge length of the axis-aligned boxes in which dice count as placed [m]."""

NO_DIE = -1
"""Index of the die at a place without one."""

_BOX = cuboid.corners(np.full(3, TARGET_WIDTH))
_FARTHEST_PX = 2**15  # OpenCV's polygon coordinates overflow beyond this


def goal_masks(rig: CameraRig | Sequence[Camera], goal: npt.ArrayLike, *, exact: bool = False) -> list[Image]:
    """Draw where each camera of a rig may see dice: the boxes around the goal's positions, without occlusion.

    Args:
        rig: the cameras.
        goal: (N, 3) [m] positions in the world; on the platform, N is 25.
        exact: whether to set exactly the pixels whose central ray, with lens distortion, meets a box. By
            default, corners are truncated to whole pixels and the faces between them filled as on the
            platform, so that errors are comparable with published ones; the boxes then reach about one
            pixel too far to the left and up.

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


DiceMasks: TypeAlias = Sequence[npt.ArrayLike | None] | Array


def error(goal_masks: Sequence[npt.ArrayLike] | Array, dice_masks: DiceMasks) -> int:
    """Return the total number of pixels that show dice outside the goal; see `error_per_camera`.

    TaskError, too, if no camera has an image: nothing is known, and 0 would be the best error.
    """
    known = [one for one in error_per_camera(goal_masks, dice_masks) if one is not None]
    if not known:
        raise TaskError("dice masks: found None for all, expected at least one")
    return sum(known)


def reward(goal_masks: Sequence[npt.ArrayLike] | Array, dice_masks: DiceMasks) -> int:
    """Return the task's reward for one set of images: the negative error."""
    return -error(goal_masks, dice_masks)


def error_per_camera(
    goal_masks: Sequence[npt.ArrayLike] | Array, dice_masks: DiceMasks
) -> tuple[int | None, ...]:
    """Return the number of pixels of each camera that show dice outside the goal; None without an image.

    Args:
        goal_masks: (H, W) of each camera, 0 and 1, 0 and 255, or bool; may be one stacked array.
        dice_masks: likewise, for the pixels that show dice; None for a camera without an image.

    Raises:
        TaskError: there is no mask, the two differ in number or shape, or a mask is not two-valued.
    """
    for what, given in (("goal masks", goal_masks), ("dice masks", dice_masks)):
        check_sequence(given, what, TaskError)
    if len(goal_masks) != len(dice_masks) or not len(goal_masks):
        raise TaskError(
            f"masks: found {len(goal_masks)} of the goal and {len(dice_masks)} of dice, "
            "expected one of each for each camera"
        )
    errors = list[int | None]()
    for index, (goal, dice) in enumerate(zip(goal_masks, dice_masks, strict=True)):
        target = as_mask(goal, f"goal mask {index}")
        if dice is None:
            errors.append(None)
            continue
        seen = as_mask(dice, f"dice mask {index}")
        if target.shape != seen.shape:
            found, valid = f"found shape {seen.shape}", f"the goal's {target.shape}"
            raise TaskError(f"dice mask {index}: {found}, expected {valid}")
        # 1 and 255 have a bit in common, so the two kinds of masks can be mixed.
        errors.append(cv2.countNonZero(seen) - cv2.countNonZero(cv2.bitwise_and(seen, target)))
    return tuple(errors)


def _box_pixels(camera: Camera, centers: FloatArray) -> FloatArray:
    """Return pixels (N, 8, 2) of the corners of boxes at `centers` (N, 3) [m]; NaN out of view."""
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
    pixels = _box_pixels(camera, centers)
    near = np.ones_like(mask)
    if (np.abs(pixels) < _FARTHEST_PX).all():
        # Distortion bends the edges outwards between the corners.
        margin = 2 + int(0.1 * np.ptp(pixels, axis=1).max(initial=0))
        near = np.asarray(cv2.dilate(_filled_mask(camera, centers), np.ones((2 * margin + 1,) * 2)), np.uint8)
    rows, columns = np.nonzero(near)
    rays, half = np.ascontiguousarray(camera.rays(np.stack([columns, rows], axis=1)).T), TARGET_WIDTH / 2
    for center in centers - camera.position:
        with np.errstate(divide="ignore", invalid="ignore"):  # 0 / 0: in a face's plane
            low, high = ((center + offset)[:, None] / rays for offset in (-half, half))
        # Slab test: a ray is inside the box where it is between all three pairs of parallel planes.
        enters = np.fmax.reduce(np.minimum(low, high), axis=0)
        leaves = np.fmin.reduce(np.maximum(low, high), axis=0)
        met = (enters <= leaves) & (leaves > 0)
        mask[rows[met], columns[met]] = 255
    return mask


def as_mask(value: npt.ArrayLike, what: str, size: tuple[int, int] | None = None) -> Image:
    """Return a mask (H, W) of 0 and 1, 0 and 255, or bool as uint8; TaskError names `what` if malformed."""
    mask = np.ascontiguousarray(array_of(value))
    if mask.dtype == np.bool_:
        mask = mask.view(np.uint8)
    if mask.dtype.kind not in "ui":
        raise TaskError(f"{what}: found type {mask.dtype}, expected bool or whole numbers")
    if mask.ndim != 2 or mask.size == 0:
        raise TaskError(f"{what}: found shape {mask.shape}, expected (height, width)")
    if size is not None and mask.shape != size:
        raise TaskError(f"{what}: found shape {mask.shape}, expected {size}")
    small = mask.astype(np.uint8, copy=False)
    highest, total = int(cv2.norm(small, cv2.NORM_INF)), cv2.norm(small, cv2.NORM_L1)
    two_valued = highest in (0, 1, 255) and total == highest * cv2.countNonZero(small)
    if not two_valued or (small is not mask and (small != mask).any()):
        found = np.unique(mask)
        few = ", ".join(str(value) for value in found[:4])
        more = ", …" if len(found) > 4 else ""
        raise TaskError(f"{what}: found the values {few}{more}, expected only 0 and 255, or only 0 and 1")
    return small


def masks_of(rig: CameraRig, masks: Sequence[npt.ArrayLike | None], what: str) -> list[Image | None]:
    """Return a rig's masks, each checked by `as_mask`, or None; TaskError if they do not fit the cameras."""
    of_kind(rig, CameraRig, "rig", TaskError, "tracker.CameraRig.load")
    check_sequence(masks, f"{what} masks", TaskError)
    if len(masks) != len(rig):
        names = ", ".join(rig.names)
        raise TaskError(f"{what} masks: found {len(masks)}, expected one of each of {names}")
    return [
        None if mask is None else as_mask(mask, f"{what} mask of {one.name}", (one.height, one.width))
        for mask, one in zip(masks, rig, strict=True)
    ]


@dataclasses.dataclass(frozen=True, eq=False)
class Assignment(Frozen):
    """The pairing of places with dice that has the smallest sum of distances; arrays are read-only."""

    die: Array
    """(N,) index of the die for each of the goal's places, NO_DIE if it has none."""
    distance: FloatArray
    """(N,) distance between place and die [m]; NaN without a die."""

    def __post_init__(self) -> None:
        freeze(self, "die", np.array(self.die, dtype=np.int64))
        freeze(self, "distance", np.array(self.distance, dtype=np.float64))

    @property
    def pairs(self) -> list[tuple[int, int]]:
        """Indices (place, die) of every pair."""
        return [(place, int(die)) for place, die in enumerate(self.die) if die != NO_DIE]

    @property
    def total(self) -> float:
        """Sum of the distances [m]."""
        return float(np.nansum(self.distance))

    def count_within(self, distance: float = TOLERANCE) -> int:
        """Return how many places have a die within `distance` [m]; TaskError if that is not a number."""
        if not is_number(distance):
            raise TaskError(f"distance: found {shown(distance)}, expected a finite distance [m]")
        return int(np.count_nonzero(self.distance <= distance))


def assign(goal: npt.ArrayLike, positions: npt.ArrayLike) -> Assignment:
    """Pair the places of a goal with dice so that the sum of their distances is minimal.

    There are min(N, M) pairs. The result is deterministic.

    Args:
        goal: (N, 3) [m] places in the world.
        positions: (M, 3) [m] centres of dice in the world; M may be 0.

    Raises:
        TaskError: goal or positions have the wrong shape or are not finite.
    """
    places, dice = finite_positions(goal, "goal"), finite_positions(positions, "dice")
    distances = np.linalg.norm(places[:, None] - dice, axis=-1)
    # Takes longer to load than all else that a summary needs.
    from scipy.optimize import linear_sum_assignment

    chosen, partners = linear_sum_assignment(distances)
    die = np.full(len(places), NO_DIE, dtype=np.int64)
    distance = np.full(len(places), np.nan)
    die[chosen], distance[chosen] = partners, distances[chosen, partners]
    return Assignment(die, distance)
