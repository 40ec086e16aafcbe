"""Files of goals: JSON, as the platform's jobs have them, or patterns.

A pattern draws a goal with characters: 17 rows of 17 cells, as the platform's pattern files have them. The
first row holds the cells of the smallest x, a row's first character that of the smallest y:
    #  outside the arena
    .  inside, empty
    X  inside, a die belongs here
After the rows the text ends, or goes on after an empty line or one of dashes and means nothing.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn, TypeVar

import numpy as np
import numpy.typing as npt

from tracker.checks import is_number, of_kind, path_of
from tracker.conventions import Array, FloatArray
from tracker.errors import TaskError, shown
from tracker.files import read_bounded, told_as, write_whole
from tracker.tasks.rearrange_dice.goals import (
    CELLS_PER_ROW,
    DIE_WIDTH,
    NUM_DICE,
    cell_centers,
    in_arena,
    told,
    validate_goal,
)

Goal = TypeVar("Goal")

OUTSIDE, EMPTY, GOAL = "#.X"

ON_CELL = 1e-6
"""How far from a cell's centre a goal may be that is drawn in it [m]."""

MAX_FILE_SIZE = 1_000_000
"""Largest file [bytes] that is parsed; goals have 2 kB."""

_JSON, _PATTERN = ".json", ".txt"


def read_goal(path: str | os.PathLike[str]) -> FloatArray:
    """The goal (25, 3) [m] in a file.

    A file that starts with `[` or `{` is JSON: a list of 25 positions `[x, y, z]` [m], or an object with
    such a list as `goal`, whose other keys are ignored. Any other file is a pattern, see `parse_pattern`.

    Raises:
        TaskError: the file cannot be read or holds no valid goal; the message names it and what is wrong.
    """
    return read_as(path, _goal_of, parse_pattern)


def read_as(
    path: str | os.PathLike[str], of_json: Callable[[Any], Goal], of_pattern: Callable[[str], Goal]
) -> Goal:
    """What a file of JSON or of a pattern means; TaskError, which names the file, where that is nothing.

    In JSON no key may be there twice, and all numbers are finite.
    """
    path = path_of(path, "goal", TaskError)
    try:
        try:
            text = read_bounded(path, MAX_FILE_SIZE).decode("utf-8-sig")
            if text.lstrip()[:1] not in ("[", "{"):
                if not text.strip():
                    raise TaskError("found an empty file, expected JSON or a pattern")
                return of_pattern(text)
            value = json.loads(text, parse_constant=_refuse_constant, object_pairs_hook=_unique)
        except OSError as error:
            raise TaskError(f"cannot be read: {error.strerror}") from error
        except UnicodeDecodeError as error:
            valid = "expected JSON or a pattern"
            raise TaskError(f"found byte {error.start}, which is no UTF-8, {valid}") from error
        except RecursionError as error:
            raise TaskError("nested too deeply, expected a goal") from error
        except ValueError as error:  # also a whole number of thousands of digits
            raise TaskError(f"not JSON: {error}") from error
        return of_json(value)
    except TaskError as error:
        raise TaskError(f"{path}: {error}") from error


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    unique = dict(pairs)
    if len(unique) < len(pairs):
        keys = [key for key, _ in pairs]
        doubled = next(key for key in keys if keys.count(key) > 1)
        raise TaskError(f"found the key {doubled[:40]!r} twice, expected it once")
    return unique


def _refuse_constant(name: str) -> NoReturn:
    raise TaskError(f"found {name}, expected finite numbers")


def _goal_of(data: Any) -> FloatArray:
    if isinstance(data, dict):
        if "goal" not in data:
            keys = ", ".join(map(repr, data))[:100] or "no key"
            raise TaskError(f"found {keys}, expected the key 'goal' with 25 positions [x, y, z]")
        data = data["goal"]
    return places_of(data)


def places_of(data: Any) -> FloatArray:
    """The goal (25, 3) [m] in a value of JSON, a list of positions; TaskError where it is none."""
    if not isinstance(data, list):
        raise TaskError(f"goal: found {shown(data)}, expected a list of 25 positions [x, y, z]")
    for index, place in enumerate(data):
        if not isinstance(place, list) or len(place) != 3:
            raise TaskError(f"goal: position {index}: found {shown(place)}, expected [x, y, z]")
        for number in place:
            if not is_number(number):
                raise TaskError(
                    f"goal: position {index}: found {shown(number)}, expected a finite number [m]"
                )
    return validate_goal(data)


def write_goal(path: str | os.PathLike[str], goal: npt.ArrayLike) -> None:
    """Write a goal (25, 3) [m], whole or not at all: as JSON (.json) or as a pattern (.txt).

    `read_goal` returns the same positions: from JSON the same bits, from a pattern in the cells' order.

    Raises:
        TaskError: the goal is not valid, a pattern cannot show it, or the file cannot be written.
    """
    target = Path(path)
    places = validate_goal(goal)
    if target.suffix.lower() == _JSON:
        rows = ",\n".join(f"  {json.dumps(place)}" for place in places.tolist())
        text = f'{{"goal": [\n{rows}\n]}}\n'
    elif target.suffix.lower() == _PATTERN:
        text = pattern(places)
    else:
        found = f"suffix {target.suffix!r}" if target.suffix else "no suffix"
        raise TaskError(f"{target}: found {found}, expected {_JSON}, or {_PATTERN} for a pattern")
    with told_as(TaskError, target):
        write_whole(target, text)


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
                f"goal: position {index}: found {told(place)}, expected the centre of a cell; "
                f"the nearest is {told(centers[i, j])}"
            )
        if filled[i, j]:
            raise TaskError(
                f"goal: position {index}: found {told(place)} a second time, expected different cells"
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
