"""Goals of the dice task, 25 places in the arena, and their files: JSON or patterns.

A pattern draws a goal with characters in 17 rows of 17 cells, like the platform's pattern files. The first
row has the cells with the smallest x; the first character of a row is the cell with the smallest y:
    #  outside the arena
    .  inside, empty
    X  inside, a die belongs here
Text after the rows is ignored if it follows an empty line or starts with a line of dashes.
"""

import json
import os
import re
from collections import Counter
from itertools import takewhile
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import numpy.typing as npt

from tracker.checks import is_number, is_whole, naming, of_kind, path_of
from tracker.conventions import Array, FloatArray
from tracker.errors import TaskError, shown
from tracker.files import check_suffix, read_bounded, reading, write_whole, writing
from tracker.tasks.checks import numbers

NUM_DICE = 25
"""Number of dice, and of places in a goal."""

DIE_WIDTH = 0.022
"""Edge length of a die [m]."""

TOLERANCE = 0.004
"""By how much the box in which a die counts as placed exceeds the die's width [m]."""

ARENA_RADIUS = 0.19
"""Radius around the arena's centre within which all corners of placed dice must be [m]."""

CELLS_PER_ROW = 17
"""Number of cells, each as wide as a die, along each side of the grid."""

SLACK = 1e-9
"""Tolerance for rounding errors at the arena's border and floor [m]."""


def cell_centers() -> FloatArray:
    """Return the centres (17, 17, 3) [m] of all cells: first axis along the world's x, second along y."""
    steps = (np.arange(CELLS_PER_ROW) - (CELLS_PER_ROW - 1) / 2) * DIE_WIDTH
    x, y = np.meshgrid(steps, steps, indexing="ij")
    return np.stack([x, y, np.full_like(x, DIE_WIDTH / 2)], axis=-1)


def in_arena(positions: Array) -> Array:
    """Return (...) bool: whether axis-aligned dice with centres (..., 3) [m] lie inside the arena."""
    return reach(positions) <= ARENA_RADIUS + SLACK


def reach(positions: Array) -> FloatArray:
    """Return distances (...) [m] from the arena's axis to axis-aligned dice's (..., 3) farthest corners."""
    corner = np.abs(positions[..., :2]) + DIE_WIDTH / 2
    return np.asarray(np.hypot(corner[..., 0], corner[..., 1]), dtype=np.float64)


def cells() -> FloatArray:
    """Return the centres (N, 3) [m] of the cells inside the arena, ordered by x, then by y."""
    centers = cell_centers().reshape(-1, 3)
    return centers[in_arena(centers)]


def sample_goal(rng: int | np.random.Generator) -> FloatArray:
    """Return a random goal (25, 3) [m]: different cells, all equally likely.

    Args:
        rng: a generator, or a seed for one.

    Raises:
        TaskError: `rng` is neither.
    """
    if not isinstance(rng, np.random.Generator) and not (is_whole(rng) and rng >= 0):
        valid = "a whole number from 0 or a numpy.random.Generator"
        raise TaskError(f"rng: found {shown(rng)}, expected {valid}")
    return np.random.default_rng(rng).choice(cells(), NUM_DICE, replace=False)


def validate_goal(goal: npt.ArrayLike) -> FloatArray:
    """Return the goal as a new array (25, 3) [m].

    As on the platform, places may overlap and be above the floor.

    Raises:
        TaskError: the goal is not 25 positions, or one is outside the arena or below its floor.
    """
    places = finite_positions(goal, "goal")
    if len(places) != NUM_DICE:
        raise TaskError(f"goal: found {len(places)} positions, expected {NUM_DICE}")
    for index, place in enumerate(places):
        what = f"goal: position {index}, {as_text(place)}"
        if not in_arena(place):
            found = f"its die reaches {reach(place):.4g} m from the arena's centre"
            raise TaskError(f"{what}: {found}, expected at most {ARENA_RADIUS} m")
        if place[2] < DIE_WIDTH / 2 - SLACK:
            found = f"found the height {place[2]:g} m"
            raise TaskError(f"{what}: {found}, expected at least half a die, {DIE_WIDTH / 2} m")
    return places


def finite_positions(value: npt.ArrayLike, what: str) -> FloatArray:
    """Return positions (N, 3) [m], N ≥ 0, as a new array; TaskError, which names `what`, if malformed."""
    places = numbers(what, value, finite=True)
    if places.size == 0 and places.ndim in (1, 2):
        return np.empty((0, 3))
    if places.ndim != 2 or places.shape[1] != 3:
        raise TaskError(f"{what}: found shape {places.shape}, expected (N, 3): N × (x, y, z)")
    return places


def as_text(position: Array) -> str:
    """Format a position for a message."""
    return f"({', '.join(f'{value:g}' for value in position)})"


OUTSIDE, EMPTY, GOAL = "#.X"

ON_CELL = 1e-6
"""Largest distance between a place and the centre of its cell in a pattern [m]."""

MAX_FILE_SIZE = 1_000_000
"""Largest file that is parsed [bytes]; goals have 2 kB."""


def read_goal(path: str | os.PathLike[str]) -> FloatArray:
    """Read a goal (25, 3) [m] from a file.

    A file that starts with `[` or `{` is JSON: a list of 25 positions `[x, y, z]` [m], or an object with
    such a list as `goal`; other keys are ignored. Any other file is a pattern, see `parse_pattern`.

    Raises:
        TaskError: the file cannot be read or has no valid goal; the message names the file and the reason.
    """
    data = read_stored(path)
    with naming(Path(path), TaskError):
        if isinstance(data, str):
            return parse_pattern(data)
        if isinstance(data, dict):
            if not {"goal", "_goal"} & set(data):
                keys = ", ".join(map(repr, data))[:100] or "no key"
                raise TaskError(f"found {keys}, expected the key 'goal' with 25 positions [x, y, z]")
            data = data.get("goal", data.get("_goal"))
        return places_of(data)


def read_stored(path: str | os.PathLike[str]) -> Any:
    """Return the list or object in a JSON file, or the text of any other file.

    TaskError names a file that cannot be read. In JSON, keys must be unique and numbers finite.
    """
    path = path_of(path, "goal", TaskError)
    with reading(path, TaskError):
        content = read_bounded(path, MAX_FILE_SIZE)
    with naming(path, TaskError):
        try:
            text = content.decode("utf-8-sig")
            if text.lstrip()[:1] not in ("[", "{"):
                if not text.strip():
                    raise TaskError("found an empty file, expected JSON or a pattern")
                return text
            return json.loads(text, parse_constant=_refuse_constant, object_pairs_hook=_unique)
        except UnicodeDecodeError as error:
            valid = "expected JSON or a pattern"
            raise TaskError(f"found byte {error.start}, which is no UTF-8, {valid}") from error
        except RecursionError as error:
            raise TaskError("nested too deeply, expected a goal") from error
        except ValueError as error:  # also raised for an integer with thousands of digits
            raise TaskError(f"not JSON: {error}") from error


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    for key, count in Counter(key for key, _ in pairs).items():
        if count > 1:
            raise TaskError(f"found the key {key[:40]!r} twice, expected it once")
    return dict(pairs)


def _refuse_constant(name: str) -> NoReturn:
    raise TaskError(f"found {name}, expected finite numbers")


def places_of(data: Any) -> FloatArray:
    """Return the goal (25, 3) [m] in a JSON value, a list of positions; TaskError if malformed."""
    if not isinstance(data, list):
        raise TaskError(f"goal: found {shown(data)}, expected a list of 25 positions [x, y, z]")
    return validate_goal([listed(place, f"goal: position {index}") for index, place in enumerate(data)])


def listed(data: Any, what: str, axes: str = "x, y, z") -> FloatArray:
    """Return a JSON value, a list of a number for each of the axes; TaskError names `what` if malformed."""
    if not isinstance(data, list) or len(data) != len(axes.split(",")):
        raise TaskError(f"{what}: found {shown(data)}, expected [{axes}]")
    for number in data:
        if not is_number(number):
            raise TaskError(f"{what}: found {shown(number)}, expected a finite number")
    return numbers(what, data, finite=True)


def write_goal(path: str | os.PathLike[str], goal: npt.ArrayLike) -> None:
    """Write a goal (25, 3) [m] atomically, as JSON (.json) or as a pattern (.txt).

    `read_goal` returns the same positions: from JSON bit for bit, from a pattern in the cells' order.

    Raises:
        TaskError: the goal is not valid, a pattern cannot show it, or the file cannot be written.
    """
    target = path_of(path, "goal", TaskError)
    places = validate_goal(goal)
    check_suffix(target, (".json", ".txt"), "goal", TaskError)
    rows = ",\n".join(f"  {json.dumps(place)}" for place in places.tolist())
    as_json = target.suffix.lower() == ".json"
    with writing(TaskError, target):
        write_whole(target, f'{{"goal": [\n{rows}\n]}}\n' if as_json else pattern(places))


def parse_pattern(text: str) -> FloatArray:
    """Return the goal (25, 3) [m] of a pattern, in the order of the text.

    Raises:
        TaskError: the text is not a pattern; rows and columns in the message count from 1.
    """
    lines = re.split(r"\r\n|\r|\n", of_kind(text, str, "pattern", TaskError))
    filled_lines = list(takewhile(bool, (line.rstrip(" \t") for line in lines)))
    rows, rest = filled_lines[:CELLS_PER_ROW], filled_lines[CELLS_PER_ROW:]
    if rest and set(rest[0]) != {"-"}:  # the platform's template has dashes, and no empty line before them
        raise TaskError(
            f"pattern: row {CELLS_PER_ROW + 1}: found {rest[0][:20]!r}, expected {CELLS_PER_ROW} rows, then "
            "nothing, an empty line or dashes"
        )
    for i, (row, inside) in enumerate(zip(rows, in_arena(cell_centers()), strict=False)):
        where = f"pattern: row {i + 1}"
        if len(row) != CELLS_PER_ROW:
            found = f"found {len(row)} characters, {row[:20]!r}"
            raise TaskError(f"{where}: {found}, expected {CELLS_PER_ROW}")
        for j, character in enumerate(row):
            valid, side = (EMPTY + GOAL, "inside") if inside[j] else (OUTSIDE, "outside")
            if character not in valid:
                expected = f"{' or '.join(map(repr, valid))} {side} the arena"
                raise TaskError(f"{where}, column {j + 1}: found {character!r}, expected {expected}")
    if len(rows) < CELLS_PER_ROW:
        raise TaskError(f"pattern: found {len(rows)} rows, expected {CELLS_PER_ROW}")
    goal: Array = np.array([list(row) for row in rows]) == GOAL
    if goal.sum() != NUM_DICE:
        raise TaskError(f"pattern: found {goal.sum()} times {GOAL!r}, expected {NUM_DICE}")
    return cell_centers()[goal]


def pattern(goal: npt.ArrayLike) -> str:
    """Return the pattern of a goal (25, 3) [m] whose places are centres of cells.

    Raises:
        TaskError: the goal is not valid, a place is not the centre of a cell, or two are in one cell.
    """
    places = validate_goal(goal)
    centers = cell_centers()
    cells = np.rint(places[:, :2] / DIE_WIDTH).astype(np.int64) + CELLS_PER_ROW // 2
    filled = np.zeros((CELLS_PER_ROW, CELLS_PER_ROW), np.bool_)
    for index, (place, (i, j)) in enumerate(zip(places, cells, strict=True)):
        found = f"goal: position {index}: found {as_text(place)}"
        if np.abs(place - centers[i, j]).max() > ON_CELL:
            nearest = as_text(centers[i, j])
            raise TaskError(f"{found}, expected the centre of a cell; the nearest is {nearest}")
        if filled[i, j]:
            raise TaskError(f"{found} a second time, expected different cells")
        filled[i, j] = True
    return _text(filled)


def empty_pattern() -> str:
    """Return a pattern without dice, to be filled in."""
    return _text(np.zeros((CELLS_PER_ROW, CELLS_PER_ROW), np.bool_))


def _text(filled: Array) -> str:
    inside = np.where(in_arena(cell_centers()), EMPTY, OUTSIDE)
    return "".join("".join(row) + "\n" for row in np.where(filled, GOAL, inside))
