"""Images of the dice task: camera views with goal areas, dice and the error, and a goal seen from above."""

import functools
from collections.abc import Iterable, Iterator, Sequence

import cv2
import numpy as np
import numpy.typing as npt

from tracker.calibration.rig import CameraRig
from tracker.checks import is_whole, naming, of_kind
from tracker.conventions import Array, FloatArray, Image
from tracker.errors import TaskError, TrackerError, shown
from tracker.geometry import so3
from tracker.geometry.camera import Camera
from tracker.tasks.checks import numbers
from tracker.tasks.rearrange_dice import Assignment
from tracker.tasks.rearrange_dice.goals import ARENA_RADIUS, DIE_WIDTH, TOLERANCE, cells, finite_positions
from tracker.tasks.rearrange_dice.score import error, masks_of
from tracker.viz import paint
from tracker.viz.overlays import DOUBTFUL, GOOD, Block, footer, panels

INSIDE: paint.Color = (150, 235, 110)
OUTSIDE: paint.Color = (20, 125, 255)
"""Colours of dice inside and outside the goal areas; they also differ in lightness, for the colour-blind."""

_INSIDE_OPACITY, _OUTSIDE_OPACITY, _AREA_OPACITY = 0.5, 0.75, 0.16
_FINE = 2  # mask outlines are found on a grid this much finer than the panel's


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
    """Return the camera views with goal and dice drawn in, above a caption with the task's error.

    Args:
        images: image (H, W, 3) uint8 BGR of each camera of the rig; None: the panel says "no image".
        rig: the cameras.
        goal_masks: mask (H, W) of each camera, see `rearrange_dice.goal_masks`; None: there is no goal.
        dice_masks: mask (H, W) of each camera, likewise; None if there is no image.
        positions: centres (N, 3) [m] of the dice found, drawn as dots.
        assignment: assignment of these dice to the goal's places, for the caption.
        title: a line above the numbers, e.g. the time.

    Raises:
        ImageError: the images do not fit the rig.
        TaskError: the masks do not fit the rig or are not two-valued, or the positions are malformed.
    """
    of_kind(title, str, "overlay: title", TrackerError)
    if assignment is not None:
        of_kind(assignment, Assignment, "overlay: assignment", TaskError, "rearrange_dice.assign")
    centers = None if positions is None else finite_positions(positions, "dice")
    seen = masks_of(rig, dice_masks, "dice")
    goals = masks_of(rig, [None] * len(rig) if goal_masks is None else goal_masks, "goal")
    errors = [
        None if goal is None or dice is None else error([goal], [dice])
        for goal, dice in zip(goals, seen, strict=True)
    ]

    def draw(index: int, panel: Image, view: Camera) -> None:
        _draw_masks(panel, goals[index], seen[index])
        pixels = view.project_in_view([] if centers is None else centers)
        for radius, color in ((4.6, paint.BLACK), (3.2, paint.WHITE)):
            for pixel in pixels[np.isfinite(pixels).all(axis=1)]:
                paint.fill(panel, paint.circle(pixel, radius), color, 1.0)

    row = panels(images, rig, draw)
    caption = _caption(rig.names, errors, seen, centers, assignment, title)
    return np.concatenate([row, footer(row.shape[1], caption)])


def _draw_masks(panel: Image, goal: Array | None, dice: Array | None) -> None:
    if goal is None:
        if dice is not None:
            _tint(panel, dice != 0, INSIDE, _INSIDE_OPACITY)
        return
    target = goal != 0
    seen = np.zeros_like(target) if dice is None else dice != 0
    _tint(panel, target & ~seen, paint.WHITE, _AREA_OPACITY)
    _tint(panel, target & seen, INSIDE, _INSIDE_OPACITY)
    _tint(panel, seen & ~target, OUTSIDE, _OUTSIDE_OPACITY)
    lines = _outlines(target, panel.shape[1], panel.shape[0])
    paint.stroke(panel, lines, paint.BLACK, 3.0, 0.35)
    paint.stroke(panel, lines, paint.WHITE, 1.2)


def _tint(panel: Image, mask: Array, color: paint.Color, opacity: float) -> None:
    """Blend a colour into the pixels of a mask, which may have any size, with soft borders."""
    coverage = cv2.resize(255 * mask.astype(np.float32), panel.shape[1::-1], interpolation=cv2.INTER_LINEAR)
    paint.blend(panel, coverage, color, opacity)


def _outlines(mask: Array, width: int, height: int) -> list[FloatArray]:
    """Return closed lines (N, 2) [px] around a mask that is scaled to `width` × `height`."""
    size = (width * _FINE, height * _FINE)
    scaled = cv2.resize(mask.astype(np.float32), size, interpolation=cv2.INTER_LINEAR)
    pixel = size[1] / mask.shape[0]
    # Blurring and simplifying the lines hides the steps of the mask's pixels.
    smooth = cv2.GaussianBlur(scaled, (0, 0), 0.5 * pixel)
    loops, _ = cv2.findContours((smooth > 0.5).astype(np.uint8), cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    simple = [cv2.approxPolyDP(loop, 0.6 * pixel, True)[:, 0] for loop in loops]
    return [(np.concatenate([loop, loop[:1]]) + 0.5) / _FINE - 0.5 for loop in simple]


def _caption(
    names: Sequence[str],
    errors: Sequence[int | None],
    dice: Sequence[Array | None],
    centers: FloatArray | None,
    assignment: Assignment | None,
    title: str,
) -> Iterator[Block]:
    counts = ["-" if mask is None else str(np.count_nonzero(mask)) for mask in dice]
    known = [value for value in errors if value is not None]
    if known:
        total = sum(known)
        color = DOUBTFUL if total else GOOD
        yield Block([title or "dice task"], [f"error {total} px"], [f"reward {-total}"], color)
        values = ["-" if value is None else str(value) for value in errors]
        yield Block(["pixels of dice", *names], ["not in the goal", *values], ["all", *counts])
    else:
        yield Block([title or "dice", *names], ["pixels", *counts], [""] * (1 + len(names)))
    if centers is None:
        return
    note, color = "", GOOD
    if assignment is not None:
        placed = assignment.count_within(TOLERANCE)
        note = f"{placed} within {1e3 * TOLERANCE:g} mm of their place"
        color = GOOD if placed == len(assignment.die) else DOUBTFUL
    yield Block(["dice"], [f"{len(centers)} found"], [note], color)


DIE: paint.Color = (255, 150, 70)

_SCALE = 38 / DIE_WIDTH
"""Scale [px/m]; cells are a whole number of pixels wide, so that all grid lines are equally sharp."""

_BORDER = 26  # around the arena [px]
_LABELS = 48  # space for the axes, left of and below the border [px]
_TICKS_M = (-0.15, -0.1, -0.05, 0.0, 0.05, 0.1, 0.15)
_TEXT_SIZE = 11.0
_FAR = 10 * ARENA_RADIUS
"""Limit, outside the image, to which coordinates are clipped so that pixels do not overflow [m]."""

_HIGHER = 1e-3  # places at least this far above the floor are marked with their height [m]

_SQUARE = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1)]) * DIE_WIDTH / 2
_SIDE = 2 * round(ARENA_RADIUS * _SCALE + _BORDER) + 1

_write = functools.partial(paint.put_text, size=_TEXT_SIZE)


def goal_picture(
    goal: npt.ArrayLike,
    positions: npt.ArrayLike | None = None,
    pairs: Iterable[tuple[int, int]] | None = None,
    *,
    yaws: npt.ArrayLike | None = None,
) -> Image:
    """Return an image of the arena from above, x to the right and y upwards, with a goal's places.

    Args:
        goal: centres (N, 3) [m] of the places; those above the floor are marked with their height.
        positions: centres (M, 3) [m] of dice to draw.
        pairs: indices (place, die) as in `Assignment.pairs`; a line joins each die to its place.
        yaws: rotations (M,) [rad] of the dice about the world's z axis; by default none is rotated.

    Raises:
        TaskError: goal, positions, pairs or rotations are malformed or do not belong together.
    """
    places = finite_positions(goal, "goal")
    dice = finite_positions([] if positions is None else positions, "dice")
    turns = np.zeros(len(dice)) if yaws is None else numbers("yaws", yaws)
    if turns.shape != (len(dice),) or not np.isfinite(turns).all():
        raise TaskError(f"yaws: found shape {turns.shape}, expected {len(dice)} finite angles")
    ways = _ways(places, dice, [] if pairs is None else pairs)
    picture = paint.canvas(_SIDE + _LABELS, _SIDE + _LABELS)
    _draw_arena(picture)
    squares = [_square(place) for place in places]
    bodies = [_square(die, turn) for die, turn in zip(dice, turns, strict=True)]
    for outlines, color, opacity in ((squares, INSIDE, 0.3), (bodies, DIE, 0.8)):
        for outline in outlines:
            paint.fill(picture, outline, color, opacity)
    paint.stroke(picture, bodies, DIE, 1.6)
    paint.stroke(picture, squares, INSIDE, 1.6)
    for way in ways:
        paint.fill(picture, paint.circle(way[0], 3.5), OUTSIDE, 1.0)
    paint.stroke(picture, ways, OUTSIDE, 2.0)
    right = _LABELS + _SIDE - 14
    high = places[places[:, 2] > DIE_WIDTH / 2 + _HIGHER]
    unit = ", heights in mm" if len(high) else ""
    _write(picture, f"{len(places)} places{unit}", (right, 24), INSIDE, align=1.0)
    if len(dice):
        _write(picture, f"{len(dice)} dice", (right, 44), DIE, align=1.0)
    for place, (x, y) in zip(high, _pixels(high), strict=True):
        _write(picture, f"{1e3 * place[2]:.0f}", (x, y + _TEXT_SIZE / 2), paint.BRIGHT, align=0.5)
    return picture


def _ways(places: FloatArray, dice: FloatArray, pairs: Iterable[tuple[int, int]]) -> list[FloatArray]:
    """Return lines (2, 2) [px] from dice to places."""
    fault = f"pairs: found {shown(pairs)}, expected pairs (place, die)"
    with naming(fault, TaskError, TypeError, ValueError):
        chosen = [(place, die) for place, die in pairs]
    valid = f"less than {len(places)} and {len(dice)}"
    for place, die in chosen:
        if not all(is_whole(n) and 0 <= n < len(of) for n, of in ((place, places), (die, dice))):
            raise TaskError(f"pairs: found place {place} and die {die}, expected {valid}")
    return [_pixels(np.stack([dice[die], places[place]])) for place, die in chosen]


def _pixels(positions: Array) -> FloatArray:
    """Return the pixels (N, 2) of positions (N, 2 or 3) [m]."""
    middle = _SIDE / 2 - 0.5
    x, y = np.clip(positions[:, :2].T, -_FAR, _FAR)
    return np.stack([_LABELS + middle + _SCALE * x, middle - _SCALE * y], axis=1)


def _draw_arena(picture: Image) -> None:
    """Draw the floor with the cells of its grid, and the axes."""
    border = paint.circle(_pixels(np.zeros((1, 2)))[0], ARENA_RADIUS * _SCALE)
    paint.fill(picture, border, (50, 43, 40), 1.0)
    paint.stroke(picture, [_square(cell) for cell in cells()], paint.FAINT, 1.0, 0.3)
    paint.stroke(picture, [border], paint.FAINT, 1.6)
    bottom, left, marks = _SIDE, _LABELS, []
    for value, (x, y) in zip(_TICKS_M, _pixels(np.stack([_TICKS_M, _TICKS_M], axis=1)), strict=True):
        marks += [np.array([(x, bottom - 6.0), (x, bottom)]), np.array([(left, y), (left + 6.0, y)])]
        _write(picture, f"{value:g}", (x, bottom + 20), paint.FAINT, align=0.5)
        _write(picture, f"{value:g}", (left - 8, y + _TEXT_SIZE / 2), paint.FAINT, align=1.0)
    paint.stroke(picture, marks, paint.FAINT, 1.2)
    _write(picture, "x [m]", (left + _SIDE - 12, bottom + 38), paint.BRIGHT, align=1.0)
    _write(picture, "y [m]", (8, 22), paint.BRIGHT)


def _square(position: Array, turn: float = 0.0) -> FloatArray:
    """Return the closed outline (5, 2) [px] of a die at a position (3,) [m], turned by an angle [rad]."""
    return _pixels(position[:2] + _SQUARE @ so3.exp([0.0, 0.0, turn])[:2, :2].T)
