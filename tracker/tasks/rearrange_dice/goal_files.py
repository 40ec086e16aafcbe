"""Files of goals: JSON, as the platform's jobs have them, or patterns."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any, NoReturn

import numpy.typing as npt

from tracker.conventions import FloatArray
from tracker.errors import TaskError
from tracker.files import read_bounded, told_as, write_whole
from tracker.tasks.rearrange_dice.goals import validate_goal
from tracker.tasks.rearrange_dice.patterns import parse_pattern, pattern

MAX_FILE_SIZE = 100_000
"""Largest file [bytes] that is parsed; goals have 2 kB."""

_JSON, _PATTERN = ".json", ".txt"


def read_goal(path: str | os.PathLike[str]) -> FloatArray:
    """The goal (25, 3) [m] in a file.

    A file that starts with `[` or `{` is JSON: a list of 25 positions `[x, y, z]` [m], or an object with
    such a list as `goal`, whose other keys are ignored. Any other file is a pattern, see `patterns`.

    Raises:
        TaskError: the file cannot be read or holds no valid goal; the message names it and what is wrong.
    """
    try:
        text = _read_text(Path(path))
        return validate_goal(_positions(text)) if text.lstrip()[:1] in ("[", "{") else parse_pattern(text)
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


def _read_text(path: Path) -> str:
    try:
        content = read_bounded(path, MAX_FILE_SIZE)
    except (OSError, ValueError) as error:  # ValueError: a null byte in the path
        reason = error.strerror if isinstance(error, OSError) else error
        raise TaskError(f"cannot be read: {reason}") from error
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise TaskError(f"found byte {error.start}, which is no UTF-8, expected JSON or a pattern") from error
    if not text.strip():
        raise TaskError("found an empty file, expected JSON or a pattern")
    return text


def _positions(text: str) -> list[list[float]]:
    """The positions in a JSON text."""
    try:
        data = json.loads(text, parse_constant=_refuse_constant, object_pairs_hook=_unique)
    except RecursionError as error:
        raise TaskError("nested too deeply, expected 25 positions [x, y, z]") from error
    except ValueError as error:  # also a whole number of thousands of digits
        raise TaskError(f"not JSON: {error}") from error
    if isinstance(data, dict):
        if "goal" not in data:
            keys = ", ".join(map(repr, data))[:100] or "no key"
            raise TaskError(f"found {keys}, expected the key 'goal' with 25 positions [x, y, z]")
        data = data["goal"]
    if not isinstance(data, list):
        raise TaskError(f"goal: found {_shown(data)}, expected a list of 25 positions [x, y, z]")
    return [_position(value, index) for index, value in enumerate(data)]


def _position(value: Any, index: int) -> list[float]:
    if not isinstance(value, list) or len(value) != 3:
        raise TaskError(f"goal: position {index}: found {_shown(value)}, expected [x, y, z]")
    for axis, number in zip("xyz", value, strict=True):
        # The bound also refuses whole numbers that no float can hold.
        if isinstance(number, bool) or not isinstance(number, (int, float)) or not abs(number) < 1e100:
            raise TaskError(
                f"goal: position {index}: {axis}: found {_shown(number)}, expected a finite number [m]"
            )
    return [float(number) for number in value]


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    unique: dict[str, Any] = {}
    for key, value in pairs:
        if key in unique:
            raise TaskError(f"found the key {key[:40]!r} twice, expected it once")
        unique[key] = value
    return unique


def _refuse_constant(name: str) -> NoReturn:
    raise TaskError(f"found {name}, expected finite numbers")


def _shown(value: Any) -> str:
    """A short description of a value of any type, whatever its size."""
    if isinstance(value, (dict, list)):
        return f"{'an object' if isinstance(value, dict) else 'a list'} of {len(value)}"
    if isinstance(value, int) and abs(value) > 10**18:
        return "a whole number above 10^18"  # Python refuses to print very large ones
    return "null" if value is None else json.dumps(value)[:60]
