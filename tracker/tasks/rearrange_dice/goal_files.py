"""Files of goals: JSON, as the platform's jobs have them, or patterns."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy.typing as npt

from tracker.checks import path_of
from tracker.conventions import FloatArray
from tracker.errors import TaskError
from tracker.files import told_as, write_whole
from tracker.tasks.goal_text import is_json, parse_json, read_text, shown
from tracker.tasks.rearrange_dice.goals import validate_goal
from tracker.tasks.rearrange_dice.patterns import parse_pattern, pattern

_JSON, _PATTERN = ".json", ".txt"


def read_goal(path: str | os.PathLike[str]) -> FloatArray:
    """The goal (25, 3) [m] in a file.

    A file that starts with `[` or `{` is JSON: a list of 25 positions `[x, y, z]` [m], or an object with
    such a list as `goal`, whose other keys are ignored. Any other file is a pattern, see `patterns`.

    Raises:
        TaskError: the file cannot be read or holds no valid goal; the message names it and what is wrong.
    """
    path = path_of(path, "goal", TaskError)
    try:
        text = read_text(path)
        if not is_json(text):
            return parse_pattern(text)
        data = parse_json(text)
        if isinstance(data, dict):
            if "goal" not in data:
                keys = ", ".join(map(repr, data))[:100] or "no key"
                raise TaskError(f"found {keys}, expected the key 'goal' with 25 positions [x, y, z]")
            data = data["goal"]
        return places_of(data)
    except TaskError as error:
        raise TaskError(f"{os.fspath(path)}: {error}") from error


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


def places_of(data: Any) -> FloatArray:
    """The goal (25, 3) [m] in a value of JSON: a list of positions.

    Raises:
        TaskError: it is none, or no valid goal.
    """
    if not isinstance(data, list):
        raise TaskError(f"goal: found {shown(data)}, expected a list of 25 positions [x, y, z]")
    return validate_goal([_position(value, index) for index, value in enumerate(data)])


def _position(value: Any, index: int) -> list[float]:
    if not isinstance(value, list) or len(value) != 3:
        raise TaskError(f"goal: position {index}: found {shown(value)}, expected [x, y, z]")
    for axis, number in zip("xyz", value, strict=True):
        # The bound also refuses whole numbers that no float can hold.
        if isinstance(number, bool) or not isinstance(number, (int, float)) or not abs(number) < 1e100:
            raise TaskError(
                f"goal: position {index}: {axis}: found {shown(number)}, expected a finite number [m]"
            )
    return [float(number) for number in value]
