"""Where the dice are: from the masks of all cameras together, and their images if there are any."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Sequence

import cv2
import numpy as np

from tracker.calibration.rig import CameraRig
from tracker.checks import check_sequence, is_whole, of_kind
from tracker.conventions import Array, FloatArray, Image
from tracker.errors import ImageError, TaskError, shown
from tracker.geometry.camera import Camera
from tracker.geometry.lens import stack_lenses
from tracker.segmentation.labels import check_image
from tracker.tasks.rearrange_dice.drawn_dice import Views
from tracker.tasks.rearrange_dice.evidence import DICE, evidence, stack
from tracker.tasks.rearrange_dice.from_above import Plan
from tracker.tasks.rearrange_dice.goals import DIE_WIDTH, NUM_DICE
from tracker.tasks.rearrange_dice.masks import as_mask
from tracker.tasks.rearrange_dice.search import Search
from tracker.tasks.rearrange_dice.set_score import Canvas

SIZE = 270
"""Shorter side of the views in which dice are looked for [px]."""

LEAST = 0.5
"""Probability below which a die is not reported."""


@dataclasses.dataclass(frozen=True, eq=False)
class Die:
    """One die that lies flat, on the table or on other dice."""

    position: FloatArray
    """(3,) its centre in the world [m]; read-only."""
    yaw: float
    """Its rotation about z [rad], from -π/4 to π/4, since its sides look alike."""
    probability: float
    """Calibrated probability that a die's centre is within half a die's edge of here."""
    gain: float
    """Log likelihood that it adds to that of the others, in pixels that it explains."""

    def __post_init__(self) -> None:
        position = np.array(self.position, dtype=np.float64)
        position.flags.writeable = False
        object.__setattr__(self, "position", position)


def locate(
    rig: CameraRig,
    masks: Sequence[Array | None],
    images: Sequence[Array | None] | None = None,
    *,
    most: int = NUM_DICE,
) -> tuple[Die, ...]:
    """The dice that explain the masks of all cameras together best, the surest first.

    Dice lie flat, in any place and turned in any way, on the table or on each other. The table may be up to
    half a die above or below the world's z = 0, as with calibrations that are off: the dice's heights tell.
    A die that fingers or other dice hide almost everywhere is not found.

    Args:
        rig: the cameras.
        masks: (H, W) of 0/1, 0/255 or bool for each camera, as `segment_dice` gives them; None: the camera
            gave no image.
        images: (H, W, 3) uint8 BGR of each camera. Tops are brighter than sides, and pips keep away from
            edges: with them dice in a crowd are told apart better than by masks alone.
        most: number of dice that there are.

    Raises:
        TaskError: a mask is malformed, or there are not as many as cameras.
        ImageError: an image is malformed, or there are not as many as cameras.
    """
    of_kind(rig, CameraRig, "rig", TaskError, "tracker.CameraRig.load")
    if not is_whole(most) or most < 0:
        raise TaskError(f"most: found {shown(most)}, expected a number of dice")
    given: Sequence[Array | None] = [None] * len(rig) if images is None else images
    for what, ones in (("masks of dice", masks), ("images", given)):
        check_sequence(ones, what, TaskError)
    _check(rig, masks, given)
    found, gains = _finder(rig).find(masks, given)
    dice = []
    for (x, y, foot, yaw), gain in zip(found[:most], gains[:most], strict=True):
        probability = _probability(float(gain), images is not None)
        if probability >= LEAST:
            turned = float((yaw + math.pi / 4) % (math.pi / 2) - math.pi / 4)
            position = np.array([x, y, foot + DIE_WIDTH / 2])
            dice.append(Die(position, turned, probability, float(gain)))
    return tuple(dice)


def _check(rig: CameraRig, masks: Sequence[Array | None], images: Sequence[Array | None]) -> None:
    names = ", ".join(rig.names)
    if len(masks) != len(rig):
        raise TaskError(f"masks of dice: found {len(masks)}, expected one of each of {names}")
    if len(images) != len(rig):
        raise ImageError(f"images: found {len(images)}, expected one of each of {names}")
    for camera, mask, image in zip(rig, masks, images, strict=True):
        size = (camera.height, camera.width)
        if mask is not None:
            as_mask(mask, f"mask of dice of {camera.name}", size)
        if image is not None and check_image(image, f"image of {camera.name}").shape[:2] != size:
            found = f"{image.shape[1]}×{image.shape[0]} px"
            raise ImageError(
                f"image of {camera.name}: found {found}, expected {camera.width}×{camera.height} px"
            )


PROBABILITY = {True: (-4.21, 1.571), False: (-2.62, 1.140)}
"""Log odds that a die is real: offset, and weight of the log of its gain; with images and with masks alone.
Fitted by scripts/fit_dice_probability.py on rendered scenes."""


def _probability(gain: float, shaded: bool) -> float:
    offset, slope = PROBABILITY[shaded]
    return 1 / (1 + math.exp(-offset - slope * math.log(max(gain, 1.0))))


class Finder:
    """Finds dice with one rig; holds what depends on the rig alone."""

    def __init__(self, rig: CameraRig) -> None:
        self._cameras = [_reduced_camera(camera) for camera in rig]
        self._lenses = stack_lenses(self._cameras)
        size = (max(c.height for c in self._cameras), max(c.width for c in self._cameras))
        self._slopes = np.zeros((len(self._cameras), *size, 2), np.float32)
        for slopes, camera in zip(self._slopes, self._cameras, strict=True):
            slopes[: camera.height, : camera.width] = _slopes(camera)
        self._plan = Plan(tuple(self._cameras))

    def find(
        self, masks: Sequence[Array | None], images: Sequence[Image | None]
    ) -> tuple[FloatArray, FloatArray]:
        """Dice (N, 4) as (x, y, foot, yaw) [m, rad], and what each gains (N,); the greatest gain first."""
        seen = [
            evidence(_reduced_mask(mask, camera), _reduced(image, camera), (camera.height, camera.width))
            for mask, image, camera in zip(masks, images, self._cameras, strict=True)
        ]
        if not any((view.mask == DICE).any() for view in seen):
            return np.empty((0, 4)), np.empty(0)
        views = Views(self._slopes, self._lenses, *stack(seen))
        canvas = Canvas(*(np.zeros(views.masks.shape, kind) for kind in (np.float32, np.int8, np.int16)))
        return Search(views, seen, self._plan, canvas).run()


@functools.lru_cache(maxsize=4)
def _finder(rig: CameraRig) -> Finder:
    return Finder(rig)


def _slopes(camera: Camera) -> FloatArray:
    """How far each pixel's ray (H, W, 2) travels along x and y while it sinks by 1."""
    columns, rows = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    rays = camera.rays(np.stack([columns, rows], axis=-1).reshape(-1, 2))
    # A ray that does not sink meets no table; a slope beyond all dice stands for it.
    sink = np.maximum(-np.nan_to_num(rays[:, 2], nan=0.0), 1e-3)
    slopes: FloatArray = np.nan_to_num(rays[:, :2] / sink[:, None], nan=1e3)
    return slopes.reshape(camera.height, camera.width, 2)


def _reduced_mask(mask: Array | None, camera: Camera) -> Image | None:
    if mask is None:
        return None
    small = _reduced(np.where(mask > 0, np.uint8(255), np.uint8(0)), camera)
    return None if small is None else np.asarray(small >= 128, dtype=np.uint8)


def _reduced(image: Image | None, camera: Camera) -> Image | None:
    size = (camera.width, camera.height)
    if image is None or image.shape[1::-1] == size:
        return image
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _reduced_camera(camera: Camera) -> Camera:
    """The camera of images reduced by a whole factor so that their shorter side comes nearest to SIZE."""
    factor = max(1, round(min(camera.width, camera.height) / SIZE))
    return camera.resized(camera.width // factor, camera.height // factor)
