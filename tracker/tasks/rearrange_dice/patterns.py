"""Goals drawn with characters: 17 rows of 17 cells, as the platform's pattern files have them.

The first row holds the cells of the smallest x, a row's first character that of the smallest y:
    #  outside the arena
    .  inside, empty
    X  inside, a die belongs here
After the rows the text ends, or goes on after an empty line or one of dashes and means nothing.
"""

from __future__ import annotations

import re

import numpy as np
import numpy.typing as npt

from tracker.checks import of_kind
from tracker.conventions import Array, FloatArray
from tracker.errors import TaskError
from tracker.tasks.rearrange_dice.goals import (
    CELLS_PER_ROW,
    DIE_WIDTH,
    NUM_DICE,
    cell_centers,
    in_arena,
    shown,
    validate_goal,
)

OUTSIDE, EMPTY, GOAL = "#.X"

ON_CELL = 1e-6
"""How far from a cell's centre a goal may be that is drawn in it [m]."""


def parse_pattern(text: str) -> FloatArray:
    """The goal (25, 3) [m] of a pattern, in the order of the text.

    Raises:
        TaskError: the text is no pattern; rows and columns in the message count from 1.
    """
    rows = _rows(of_kind(text, str, "pattern", TaskError))
    inside = in_arena(cell_centers())
    goal = np.zeros((CELLS_PER_ROW, CELLS_PER_ROW), np.bool_)
    for i, row in enumerate(rows):
        if len(row) != CELLS_PER_ROW:
            raise TaskError(
                f"pattern: row {i + 1}: found {len(row)} characters, {row[:20]!r}, expected {CELLS_PER_ROW}"
            )
        for j, character in enumerate(row):
            valid = EMPTY + GOAL if inside[i, j] else OUTSIDE
            if character not in valid:
                where = "inside" if inside[i, j] else "outside"
                raise TaskError(
                    f"pattern: row {i + 1}, column {j + 1}: found {character!r}, expected "
                    f"{' or '.join(map(repr, valid))} {where} the arena"
                )
            goal[i, j] = character == GOAL
    if len(rows) < CELLS_PER_ROW:
        raise TaskError(f"pattern: found {len(rows)} rows, expected {CELLS_PER_ROW}")
    if goal.sum() != NUM_DICE:
        raise TaskError(f"pattern: found {goal.sum()} times {GOAL!r}, expected {NUM_DICE}")
    return cell_centers()[goal]


def pattern(goal: npt.ArrayLike) -> str:
    """The pattern of a goal (25, 3) [m] whose places are cells.

    Raises:
        TaskError: the goal is not valid, a place is not the centre of a cell, or two are in one cell.
    """
    places = validate_goal(goal)
    centers = cell_centers()
    cells = np.rint(places[:, :2] / DIE_WIDTH).astype(np.int64) + CELLS_PER_ROW // 2
    filled = np.zeros((CELLS_PER_ROW, CELLS_PER_ROW), np.bool_)
    for index, (place, (i, j)) in enumerate(zip(places, cells, strict=True)):
        if np.abs(place - centers[i, j]).max() > ON_CELL:
            raise TaskError(
                f"goal: position {index}: found {shown(place)}, expected the centre of a cell; "
                f"the nearest is {shown(centers[i, j])}"
            )
        if filled[i, j]:
            raise TaskError(
                f"goal: position {index}: found {shown(place)} a second time, expected different cells"
            )
        filled[i, j] = True
    return _text(filled)


def empty_pattern() -> str:
    """The pattern in which no cell is a goal, to be filled in."""
    return _text(np.zeros((CELLS_PER_ROW, CELLS_PER_ROW), np.bool_))


def _text(filled: Array) -> str:
    inside = np.where(in_arena(cell_centers()), EMPTY, OUTSIDE)
    return "".join("".join(row) + "\n" for row in np.where(filled, GOAL, inside))


def _rows(text: str) -> list[str]:
    """The lines, without blanks at their ends, that the pattern consists of."""
    rows: list[str] = []
    for line in re.split(r"\r\n|\r|\n", text):
        row = line.rstrip(" \t")
        # The platform's template has dashes, and no empty line before them.
        if not row or (len(rows) == CELLS_PER_ROW and set(row) == {"-"}):
            break
        if len(rows) == CELLS_PER_ROW:
            raise TaskError(
                f"pattern: row {CELLS_PER_ROW + 1}: found {row[:20]!r}, expected {CELLS_PER_ROW} rows, then "
                "nothing, an empty line or dashes"
            )
        rows.append(row)
    return rows
