"""The text of a goal's file, and the JSON in it, of which nothing is believed."""

from __future__ import annotations

import json
import os
from typing import Any, NoReturn

from tracker.errors import TaskError
from tracker.files import read_bounded

MAX_FILE_SIZE = 1_000_000
"""Largest file [bytes] that is parsed; goals have 2 kB."""


def read_text(path: str | os.PathLike[str]) -> str:
    """What is in a file, which is not empty; TaskError says what is wrong with it, and not its name."""
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


def is_json(text: str) -> bool:
    """Whether a text is meant as JSON, and not as a pattern of dice."""
    return text.lstrip()[:1] in ("[", "{")


def parse_json(text: str) -> Any:
    """The value of a JSON text in which no key is there twice and all numbers are finite."""
    try:
        return json.loads(text, parse_constant=_refuse_constant, object_pairs_hook=_unique)
    except RecursionError as error:
        raise TaskError("nested too deeply, expected a goal") from error
    except ValueError as error:  # also a whole number of thousands of digits
        raise TaskError(f"not JSON: {error}") from error


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    unique: dict[str, Any] = {}
    for key, value in pairs:
        if key in unique:
            raise TaskError(f"found the key {key[:40]!r} twice, expected it once")
        unique[key] = value
    return unique


def _refuse_constant(name: str) -> NoReturn:
    raise TaskError(f"found {name}, expected finite numbers")


def shown(value: Any) -> str:
    """A short description of a value of any type, whatever its size."""
    if isinstance(value, (dict, list)):
        return f"{'an object' if isinstance(value, dict) else 'a list'} of {len(value)}"
    if isinstance(value, int) and abs(value) > 10**18:
        return "a whole number above 10^18"  # Python refuses to print very large ones
    return "null" if value is None else json.dumps(value)[:60]
