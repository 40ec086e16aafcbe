"""A goal of the dice task from above, and the dice on their way to it."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import numpy.typing as npt

from tracker.conventions import Array, FloatArray, Image
from tracker.errors import TaskError
from tracker.geometry import so3
from tracker.tasks.rearrange_dice.goals import ARENA_RADIUS, DIE_WIDTH, cells, finite_positions
from tracker.viz import paint
from tracker.viz.dice import INSIDE, OUTSIDE

DIE: paint.Color = (255, 150, 70)

_SCALE = 38 / DIE_WIDTH
"""[px/m]; cells are a whole number of pixels wide, so that all lines of the grid are equally sharp."""
_BORDER = 26
"""Around the arena [px]."""
_LABELS = 48
"""Left of and below that, for the axes [px]."""
_FLOOR: paint.Color = (50, 43, 40)
_TICKS_M = (-0.15, -0.1, -0.05, 0.0, 0.05, 0.1, 0.15)
_TEXT_SIZE = 11.0
_FAR = 10 * ARENA_RADIUS
"""Coordinates are cut to this [m], which is out of the picture: pixels must not overflow."""
_HIGHER = 1e-3
"""Places this much above the floor [m] or more are marked with their height."""

_SQUARE = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]) * DIE_WIDTH / 2
_SIDE = 2 * round(ARENA_RADIUS * _SCALE + _BORDER) + 1


def goal_picture(
    goal: npt.ArrayLike,
    positions: npt.ArrayLike | None = None,
    pairs: Iterable[tuple[int, int]] | None = None,
    *,
    yaws: npt.ArrayLike | None = None,
) -> Image:
    """The arena from above, x to the right and y upwards, with a goal's places.

    Args:
        goal: (N, 3) [m] centres of the places; those above the floor are marked with their height.
        positions: (M, 3) [m] centres of dice to draw.
        pairs: (place, die) indices, as `Assignment.pairs` has them: a line shows the die's way.
        yaws: (M,) [rad] rotations of the dice about the world's z axis; by default none is rotated.

    Raises:
        TaskError: goal, positions, pairs or rotations are malformed or do not belong together.
    """
    places = np.clip(finite_positions(goal, "goal"), -_FAR, _FAR)
    dice = np.clip(finite_positions([] if positions is None else positions, "dice"), -_FAR, _FAR)
    turns = np.zeros(len(dice)) if yaws is None else np.asarray(yaws, dtype=np.float64)
    if turns.shape != (len(dice),) or not np.isfinite(turns).all():
        raise TaskError(f"yaws: found shape {turns.shape}, expected {len(dice)} finite angles")
    ways = _ways(places, dice, [] if pairs is None else pairs)
    picture: Image = np.full((_SIDE + _LABELS, _SIDE + _LABELS, 3), paint.BACKGROUND, np.uint8)
    _draw_arena(picture)
    _draw_axes(picture)
    squares = [_square(place, 0.0) for place in places]
    bodies = [_square(die, turn) for die, turn in zip(dice, turns, strict=True)]
    for outlines, color, opacity in ((squares, INSIDE, 0.3), (bodies, DIE, 0.8)):
        for outline in outlines:
            paint.fill(picture, outline, color, opacity)
    paint.stroke(picture, bodies, DIE, 1.6)
    paint.stroke(picture, squares, INSIDE, 1.6)
    for way in ways:
        paint.fill(picture, paint.circle(way[0], 3.5), OUTSIDE, 1.0)
    paint.stroke(picture, ways, OUTSIDE, 2.0)
    _draw_counts(picture, len(places), len(dice))
    _draw_heights(picture, places)
    return picture


def _ways(places: FloatArray, dice: FloatArray, pairs: Iterable[tuple[int, int]]) -> list[FloatArray]:
    """Lines (2, 2) [px] from dice to places."""
    lines = []
    for place, die in pairs:
        if not (0 <= place < len(places) and 0 <= die < len(dice)):
            raise TaskError(
                f"pairs: found place {place} and die {die}, expected less than {len(places)} and {len(dice)}"
            )
        lines.append(_pixels(np.stack([dice[die], places[place]])))
    return lines


def _pixels(positions: Array) -> FloatArray:
    """Pixels (N, 2) of positions (N, 2 or 3) [m]."""
    middle = _SIDE / 2 - 0.5
    x, y = positions[:, 0], positions[:, 1]
    return np.stack([_LABELS + middle + _SCALE * x, middle - _SCALE * y], axis=1)


def _draw_arena(picture: Image) -> None:
    border = paint.circle(_pixels(np.zeros((1, 2)))[0], ARENA_RADIUS * _SCALE)
    paint.fill(picture, border, _FLOOR, 1.0)
    squares = [_square(cell, 0.0) for cell in cells()]
    paint.stroke(picture, squares, paint.FAINT, 1.0, 0.3)
    paint.stroke(picture, [border], paint.FAINT, 1.6)


def _draw_axes(picture: Image) -> None:
    """Ticks and their labels along the left and the lower border."""
    top, bottom, left = 0, _SIDE, _LABELS
    ticks = _pixels(np.stack([_TICKS_M, _TICKS_M], axis=1))
    marks = []
    for value, (x, y) in zip(_TICKS_M, ticks, strict=True):
        marks += [np.array([(x, bottom - 6.0), (x, bottom)]), np.array([(left, y), (left + 6.0, y)])]
        label = f"{value:g}"
        paint.put_text(picture, label, (x, bottom + 20), paint.FAINT, size=_TEXT_SIZE, align=0.5)
        paint.put_text(
            picture, label, (left - 8, y + _TEXT_SIZE / 2), paint.FAINT, size=_TEXT_SIZE, align=1.0
        )
    paint.stroke(picture, marks, paint.FAINT, 1.2)
    end = _SIDE + _LABELS - 12
    paint.put_text(picture, "x [m]", (end, bottom + 38), paint.BRIGHT, size=_TEXT_SIZE, align=1.0)
    paint.put_text(picture, "y [m]", (8, top + 22), paint.BRIGHT, size=_TEXT_SIZE)


def _square(position: Array, turn: float) -> FloatArray:
    """The closed outline (5, 2) [px] of a die at a position (3,) [m], turned by an angle [rad]."""
    rotation = so3.exp([0.0, 0.0, turn])[:2, :2]
    return _pixels(position[:2] + _SQUARE[[0, 1, 2, 3, 0]] @ rotation.T)


def _draw_counts(picture: Image, places: int, dice: int) -> None:
    """The legend: how many places and dice there are, in their colours."""
    right = _LABELS + _SIDE - 14
    rows = [(f"{places} places", INSIDE), (f"{dice} dice", DIE)]
    for row, (text, color) in enumerate(rows if dice else rows[:1]):
        paint.put_text(picture, text, (right, 24 + 20 * row), color, size=_TEXT_SIZE, align=1.0)


def _draw_heights(picture: Image, places: FloatArray) -> None:
    for place, (x, y) in zip(places, _pixels(places), strict=True):
        if place[2] > DIE_WIDTH / 2 + _HIGHER:
            text = f"{1e3 * place[2]:.0f}"
            paint.put_text(picture, text, (x, y + _TEXT_SIZE / 2), paint.BRIGHT, size=_TEXT_SIZE, align=0.5)
