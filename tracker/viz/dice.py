"""The views of the dice task: goal areas outlined, dice coloured by whether they are there, the error."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import cv2
import numpy as np
import numpy.typing as npt

from tracker.calibration.rig import CameraRig
from tracker.conventions import Array, FloatArray, Image
from tracker.errors import TaskError
from tracker.geometry.camera import Camera
from tracker.tasks.rearrange_dice import Assignment
from tracker.tasks.rearrange_dice.goals import TOLERANCE, finite_positions
from tracker.tasks.rearrange_dice.score import error_per_camera
from tracker.viz import paint
from tracker.viz.footer import DOUBTFUL, GOOD, Block, footer
from tracker.viz.panels import panels

INSIDE: paint.Color = (150, 235, 110)
OUTSIDE: paint.Color = (20, 125, 255)
"""Of dice in the goal's areas, and elsewhere; they differ in lightness too, for eyes that mix up colours."""

_INSIDE_OPACITY, _OUTSIDE_OPACITY, _AREA_OPACITY = 0.5, 0.75, 0.16
_FINE = 2
"""Outlines of masks are found on a grid this much finer than the panel's."""


def dice_overlay(
    images: Sequence[Image | None],
    rig: CameraRig,
    goal_masks: Sequence[Array] | None,
    dice_masks: Sequence[Array | None],
    *,
    positions: npt.ArrayLike | None = None,
    assignment: Assignment | None = None,
    title: str = "",
) -> Image:
    """The views with goal and dice in them, and a caption with the task's error below.

    Args:
        images: (H, W, 3) uint8 BGR of each camera of the rig; None: the panel says that there is none.
        rig: the cameras.
        goal_masks: (H, W) of each camera, see `rearrange_dice.goal_masks`; None: there is no goal.
        dice_masks: (H, W) of each camera, of the same kind; None where there is no image.
        positions: (N, 3) [m] centres of the dice found, drawn as dots.
        assignment: of these dice to the goal's places, for the caption.
        title: a line above the numbers, e.g. the time.

    Raises:
        ImageError: the images do not fit the rig.
        TaskError: the masks do not fit the rig or are not two-valued, or the positions are malformed.
    """
    centers = None if positions is None else finite_positions(positions, "dice")
    goals = [None] * len(rig) if goal_masks is None else list(goal_masks)
    for what, masks in (("goal", goals), ("dice", dice_masks)):
        _check(what, masks, rig)
    errors = [
        None if goal is None or dice is None else error_per_camera([goal], [dice])[0]
        for goal, dice in zip(goals, dice_masks, strict=True)
    ]

    def draw(index: int, panel: Image, view: Camera) -> None:
        _draw_masks(panel, goals[index], dice_masks[index])
        if centers is not None:
            _draw_dots(panel, view.project_in_view(centers))

    row = panels(images, rig, draw)
    blocks = [*_pixel_blocks(rig.names, errors, dice_masks, title), *_dice_blocks(centers, assignment)]
    return np.concatenate([row, footer(row.shape[1], blocks)])


def _check(what: str, masks: Sequence[Array | None], rig: CameraRig) -> None:
    if len(masks) != len(rig):
        raise TaskError(
            f"overlay: found {len(masks)} {what} masks, expected one for each of {', '.join(rig.names)}"
        )
    for mask, camera in zip(masks, rig, strict=True):
        expected = (camera.height, camera.width)
        if mask is not None and mask.shape != expected:
            raise TaskError(f"overlay: {camera.name}: found a {what} mask {mask.shape}, expected {expected}")


def _draw_masks(panel: Image, goal: Array | None, dice: Array | None) -> None:
    seen = np.zeros(panel.shape[:2] if goal is None else goal.shape, np.bool_) if dice is None else dice != 0
    if goal is None:
        _tint(panel, seen, INSIDE, _INSIDE_OPACITY)
        return
    wanted = goal != 0
    _tint(panel, wanted & ~seen, paint.WHITE, _AREA_OPACITY)
    _tint(panel, wanted & seen, INSIDE, _INSIDE_OPACITY)
    _tint(panel, seen & ~wanted, OUTSIDE, _OUTSIDE_OPACITY)
    lines = _outlines(wanted, panel.shape[1], panel.shape[0])
    paint.stroke(panel, lines, paint.BLACK, 3.0, 0.35)
    paint.stroke(panel, lines, paint.WHITE, 1.2)


def _tint(panel: Image, mask: Array, color: paint.Color, opacity: float) -> None:
    """Blend a colour into the pixels of a mask of any size, with soft borders."""
    coverage = cv2.resize(255 * mask.astype(np.float32), panel.shape[1::-1], interpolation=cv2.INTER_LINEAR)
    paint.blend(panel, coverage, color, opacity)


def _outlines(mask: Array, width: int, height: int) -> list[FloatArray]:
    """Closed lines (N, 2) [px] around a mask that is scaled to `width` × `height`."""
    size = (width * _FINE, height * _FINE)
    scaled = cv2.resize(mask.astype(np.float32), size, interpolation=cv2.INTER_LINEAR)
    pixel = size[1] / mask.shape[0]
    # Blurred and simplified, lines do not show the steps of the mask's pixels.
    smooth = cv2.GaussianBlur(scaled, (0, 0), 0.5 * pixel)
    loops, _ = cv2.findContours((smooth > 0.5).astype(np.uint8), cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    simple = [cv2.approxPolyDP(loop, 0.6 * pixel, True) for loop in loops]
    closed = [np.concatenate([loop, loop[:1]])[:, 0] for loop in simple]
    return [(loop + 0.5) / _FINE - 0.5 for loop in closed]


def _draw_dots(panel: Image, pixels: FloatArray) -> None:
    seen = pixels[np.isfinite(pixels).all(axis=1)]
    for radius, color in ((4.6, paint.BLACK), (3.2, paint.WHITE)):
        for pixel in seen:
            paint.fill(panel, paint.circle(pixel, radius), color, 1.0)


def _pixel_blocks(
    names: Sequence[str], errors: Sequence[int | None], dice: Sequence[Array | None], title: str
) -> Iterable[Block]:
    counts = ["-" if mask is None else str(np.count_nonzero(mask)) for mask in dice]
    known = [value for value in errors if value is not None]
    if not known:
        yield Block(([title or "dice", *names], ["pixels", *counts], [""] * (1 + len(names))))
        return
    total = sum(known)
    color = DOUBTFUL if total else GOOD
    yield Block(([title or "dice task"], [f"error {total} px"], [f"reward {-total}"]), color)
    values = ["-" if value is None else str(value) for value in errors]
    yield Block((["pixels of dice", *names], ["not in the goal", *values], ["all", *counts]))


def _dice_blocks(centers: FloatArray | None, assignment: Assignment | None) -> Iterable[Block]:
    if centers is None:
        return
    found = [f"{len(centers)} found"]
    if assignment is None:
        yield Block((["dice"], found, [""]))
        return
    placed = assignment.count_within(TOLERANCE)
    told = f"{placed} within {1e3 * TOLERANCE:g} mm of their place"
    yield Block((["dice"], found, [told]), GOOD if placed == len(assignment.die) else DOUBTFUL)
