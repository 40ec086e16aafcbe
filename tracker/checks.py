"""Checks of arguments by kind: numbers, arrays of them, paths, stamps; and of what is installed."""

from __future__ import annotations

import contextlib
import math
import numbers
import os
from collections.abc import Iterator, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, TypeGuard, TypeVar

import numpy as np

from tracker.conventions import Array, FloatArray
from tracker.errors import TrackerError, install, shown

Kind = TypeVar("Kind")


def optional(package: str, extra: str, what: str, fault: type[TrackerError] = TrackerError) -> Any:
    """A package of an extra, or a part of one; `fault` says `what` needs it where it is missing."""
    try:
        return import_module(package)
    except ImportError as error:
        name = package.partition(".")[0]
        raise fault(f"{what} needs the package {name}: {install(extra)}") from error


@contextlib.contextmanager
def naming(
    where: object, fault: type[TrackerError], *caught: type[Exception], sep: str = ": "
) -> Iterator[None]:
    """What is raised within, a `fault` or what is `caught` instead, is a `fault` that begins with `where`.

    Its message is one line, whatever the message of what is caught is.
    """
    kinds = caught or (fault,)
    try:
        yield
    except kinds as error:
        raise fault(f"{where}{sep}{' '.join(str(error).splitlines())}") from error


def of_kind(given: object, kind: type[Kind], what: str, fault: type[TrackerError], how: str = "") -> Kind:
    """The value itself if it is of a kind; `fault`, which names `what` and says `how` to get one, if not."""
    if not isinstance(given, kind):
        hint = f", as {how} gives" if how else ""
        raise fault(f"{what}: found {shown(given)}, expected {kind.__name__}{hint}")
    return given


def check_sequence(given: object, what: str, fault: type[TrackerError], valid: str = "a sequence") -> None:
    """Refuse what has no items, and texts, whose items nobody means, by a `fault` that names `what`."""
    if isinstance(given, np.ndarray) and given.ndim:
        return
    if isinstance(given, str | bytes) or not isinstance(given, Sequence):
        raise fault(f"{what}: found {shown(given)}, expected {valid}")


def path_of(given: object, what: str, fault: type[TrackerError], valid: str = "a path") -> Path:
    """A path; `fault`, which names `what`, where it is none or has a null byte in it."""
    text = os.fspath(given) if isinstance(given, str | os.PathLike) else None
    if not isinstance(text, str):
        raise fault(f"{what}: found {shown(given)}, expected {valid}")
    if "\0" in text:
        raise fault(f"{what}: found a null byte in it, expected {valid}")
    return Path(text)


def is_whole(value: object) -> TypeGuard[int]:
    """Whether it is a whole number of any kind; truth values and spans of time are none."""
    return isinstance(value, int | np.integer) and not isinstance(value, bool | np.timedelta64)


def is_number(value: object) -> bool:
    """Whether it is one finite real number of any kind; truth values and spans of time are none."""
    if isinstance(value, bool | np.timedelta64) or not isinstance(value, numbers.Real):
        return False
    try:
        return math.isfinite(value)
    except OverflowError:  # a whole number beyond the greatest float
        return False


def freeze(instance: object, name: str, array: Array) -> None:
    """Make an array read-only, and the value of a field of a frozen dataclass."""
    array.flags.writeable = False
    object.__setattr__(instance, name, array)


def described(array: Any) -> str:
    """Type and shape of an array, or of what has them as one, for messages."""
    return f"{array.dtype} of shape {array.shape}"


def _array(given: object) -> Array:
    """An array of what makes one; of a ragged sequence, one without numbers."""
    try:
        return np.asarray(given)
    except (TypeError, ValueError):
        return np.asarray(None)


def float_rows(given: object, width: int, what: str, fault: type[TrackerError]) -> FloatArray:
    """Rows (N, width) in double precision; `fault`, which names `what`, where the numbers make none."""
    array = _array(given)
    if array.dtype.kind not in "iuf" or array.size % width:
        raise fault(f"{what}: found {shown(given)}, expected numbers of shape (N, {width})")
    return array.astype(np.float64, copy=False).reshape(-1, width)


def float_array(
    given: object, shape: tuple[int, ...], what: str, fault: type[TrackerError], *, finite: bool = True
) -> FloatArray:
    """A read-only copy in double precision; `fault`, which names `what`, where it is none of that shape."""
    array = _array(given)
    numeric = array.dtype.kind in "iuf"
    if not numeric or array.shape != shape:
        other = described(array) if isinstance(given, np.ndarray) else shown(given)
        found = f"shape {array.shape}" if numeric else other
        raise fault(f"{what}: found {found}, expected numbers of shape {shape}")
    result: FloatArray = array.astype(np.float64)
    if finite and not np.isfinite(result).all():
        raise fault(f"{what}: found values that are not finite, expected finite numbers")
    result.flags.writeable = False
    return result


LATEST = 1e11
"""Greatest stamp [s], more than three thousand years: a greater one counts nanoseconds or the like."""


def seconds(given: object, what: str, fault: type[TrackerError] = TrackerError) -> FloatArray:
    """Numbers as stamps [s], in their shape; `fault`, which names `what`, where they are none.

    Texts and datetime64 are none: neither says its unit.
    """
    stamps = _array(given)
    if stamps.dtype.kind not in "iuf":
        hint = "; of datetime64 take t.astype('datetime64[ns]').astype(float) / 1e9"
        raise fault(
            f"{what}: found {shown(given)}, expected finite numbers of seconds"
            f"{hint if stamps.dtype.kind == 'M' else ''}"
        )
    return stamps.astype(np.float64)


def one_stamp(given: object, what: str, fault: type[TrackerError] = TrackerError) -> float:
    """One stamp [s]; `fault`, which names `what`, where it is none or out of range."""
    stamp = seconds(given, what, fault)
    if stamp.ndim:
        raise fault(f"{what}: found {shown(given)}, expected one finite number of seconds")
    return float(in_range(stamp, what, fault))


def in_range(stamps: FloatArray, what: str, fault: type[TrackerError] = TrackerError) -> FloatArray:
    """The stamps [s]; `fault`, which names `what`, where one is not finite or cannot be in seconds."""
    found = shown(tuple(stamps.tolist()) if stamps.ndim else stamps.item())
    if not np.isfinite(stamps).all():
        raise fault(f"{what}: found {found}, expected finite numbers of seconds")
    if np.abs(stamps).max(initial=0) > LATEST:
        raise fault(
            f"{what}: found {found}, expected seconds, up to {LATEST:g}; "
            "is it in nanoseconds, of which 1e9 are a second?"
        )
    return stamps
