"""Checks of arguments (numbers, arrays, paths, timestamps) and of optional packages."""

import contextlib
import math
import numbers
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from importlib import import_module
from pathlib import Path
from typing import Any, TypeGuard, TypeVar

import numpy as np

from tracker.conventions import Array, FloatArray
from tracker.errors import TrackerError, install, shown

Kind = TypeVar("Kind")

UNSTAMPED = "found none for any camera, expected one number, the current time, for a set without images"


def optional(package: str, extra: str | None, what: str, fault: type[TrackerError] = TrackerError) -> Any:
    """Import a package (or submodule), of an extra or none; if missing, raise `fault`, which names `what`."""
    try:
        return import_module(package)
    except ImportError as error:
        name = package.partition(".")[0]
        how = install(extra) if extra else f"pip install {name}"
        raise fault(f"{what} needs the package {name}: {how}") from error


@contextlib.contextmanager
def naming(
    where: object, fault: type[TrackerError], *caught: type[Exception], sep: str = ": "
) -> Iterator[None]:
    """Turn errors raised in the `with` block into a `fault` whose message begins with `where`.

    `caught` lists the error types to convert, by default `fault` alone. The message is always one line.
    """
    kinds = caught or (fault,)
    try:
        yield
    except kinds as error:
        raise fault(f"{where}{sep}{' '.join(str(error).splitlines())}") from error


def of_kind(given: object, kind: type[Kind], what: str, fault: type[TrackerError], how: str = "") -> Kind:
    """Return the value if it is a `kind`; else raise `fault`, which names `what` and `how` to get one."""
    if not isinstance(given, kind):
        hint = f", as {how} gives" if how else ""
        raise fault(f"{what}: found {shown(given)}, expected {kind.__name__}{hint}")
    return given


def check_sequence(given: object, what: str, fault: type[TrackerError], valid: str = "a sequence") -> None:
    """Raise `fault`, which names `what`, unless `given` is a sequence. Strings and bytes are refused, too."""
    if isinstance(given, np.ndarray) and given.ndim:
        return
    if isinstance(given, str | bytes) or not isinstance(given, Sequence):
        raise fault(f"{what}: found {shown(given)}, expected {valid}")


def path_of(given: object, what: str, fault: type[TrackerError], valid: str = "a path") -> Path:
    """Return `given` as a Path; raise `fault`, which names `what`, if it is not a path or has a null byte."""
    text = os.fspath(given) if isinstance(given, str | os.PathLike) else None
    if not isinstance(text, str):
        raise fault(f"{what}: found {shown(given)}, expected {valid}")
    if "\0" in text:
        raise fault(f"{what}: found a null byte in it, expected {valid}")
    return Path(text)


def is_whole(value: object) -> TypeGuard[int]:
    """Whether the value is an integer of any type; bool and timedelta64 do not count."""
    return isinstance(value, int | np.integer) and not isinstance(value, bool | np.timedelta64)


def is_number(value: object) -> bool:
    """Whether the value is one finite real number of any type; bool and timedelta64 do not count."""
    if isinstance(value, bool | np.timedelta64) or not isinstance(value, numbers.Real):
        return False
    try:
        return math.isfinite(value)
    except OverflowError:  # an integer above the largest float
        return False


def freeze(instance: object, name: str, array: Array) -> None:
    """Make an array read-only and assign it to the field `name` of a frozen dataclass."""
    array.flags.writeable = False
    object.__setattr__(instance, name, array)


@dataclass(frozen=True, eq=False)
class Frozen:
    """Base of dataclasses whose arrays are read-only, also in copies and from pickles."""

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        for field in fields(self):
            if isinstance(array := getattr(self, field.name), np.ndarray):
                array.flags.writeable = False


def described(array: Any) -> str:
    """Return dtype and shape of an array, or of anything that has both, for messages."""
    return f"{array.dtype} of shape {array.shape}"


def array_of(given: object) -> Array:
    """Convert to an array, of dtype object if the input is ragged, refuses, or has masked values."""
    if isinstance(given, np.ndarray) and type(given) is not np.ndarray and np.ma.is_masked(given):
        return np.asarray(None)
    try:
        return np.asarray(given)
    except (TypeError, ValueError, RuntimeError):
        return np.asarray(None)


def in_8_bits(image: Array) -> tuple[int, str]:
    """Return how many of its 16 bits a camera's image uses, and the expression that reduces it to 8."""
    bits = next(bits for bits in (8, 10, 12, 16) if image.max(initial=0) < 1 << bits)
    return bits, f"(image >> {bits - 8}).astype(np.uint8)" if bits > 8 else "image.astype(np.uint8)"


BLACK = 12
"""Level that the brightest pixel of an image must reach; otherwise the image counts as black."""

ROWS = 8
"""Step between the rows of pixels examined, for speed; film decoders repeat 4 to 16 rows."""


def sampled(image: Array) -> Array:
    """Return the rows of an image (H, W, 3) that show whether it is black, or has changed."""
    return image[len(image) % ROWS // 2 :: ROWS]


def is_black(image: Array) -> bool:
    """Whether the sampled rows of an image (H, W, 3) are black."""
    rows = sampled(image)
    # Most images show a bright pixel at once.
    return bool(rows[len(rows) // 2, 0, 0] < BLACK and rows.max() < BLACK)


def shows(image: Array | None) -> TypeGuard[Array]:
    """Whether there is an image (H, W, 3), and it is not black."""
    return image is not None and not is_black(image)


def shown_in(images: Sequence[Array | None]) -> list[bool]:
    """Return whether each image is there and not black; if all of them are black, whether it is there."""
    lit = [shows(image) for image in images]
    return lit if any(lit) else [image is not None for image in images]


def float_rows(given: object, width: int, what: str, fault: type[TrackerError]) -> FloatArray:
    """Return float64 rows (N, width); raise `fault`, which names `what`, if the input does not fit."""
    array = array_of(given)
    numeric = array.dtype.kind in "iuf"
    if not numeric or (array.size and array.shape[-1:] != (width,)):
        found = f"shape {array.shape}" if numeric else shown(given)
        raise fault(f"{what}: found {found}, expected numbers of shape (N, {width})")
    return array.astype(np.float64, copy=False).reshape(-1, width)


def float_array(
    given: object, shape: tuple[int, ...], what: str, fault: type[TrackerError], *, finite: bool = True
) -> FloatArray:
    """Return a read-only float64 copy; raise `fault`, which names `what`, if the shape or type is wrong."""
    array = array_of(given)
    numeric = array.dtype.kind in "iuf"
    if not numeric or array.shape != shape:
        found = f"shape {array.shape}" if numeric else shown(given)
        raise fault(f"{what}: found {found}, expected numbers of shape {shape}")
    result: FloatArray = array.astype(np.float64)
    if finite and not np.isfinite(result).all():
        raise fault(f"{what}: found values that are not finite, expected finite numbers")
    result.flags.writeable = False
    return result


LATEST = 1e11
"""Largest valid timestamp [s], over three thousand years: anything larger is not in seconds."""


def seconds(given: object, what: str, fault: type[TrackerError] = TrackerError) -> FloatArray:
    """Return timestamps [s] as float64 of the same shape; raise `fault`, which names `what`, for non-numbers.

    Strings and datetime64 are refused, since neither states its unit; so are numbers rounded to over 1 ms.
    """
    stamps = array_of(given)
    if stamps.dtype.kind not in "iuf":
        remedy = "; of datetime64 take t.astype('datetime64[ns]').astype(float) / 1e9"
        hint = remedy if stamps.dtype.kind == "M" else ""
        raise fault(f"{what}: found {shown(given)}, expected finite numbers of seconds{hint}")
    exact = stamps.astype(np.float64)
    if stamps.dtype.kind == "f" and stamps.itemsize < 8 and (exact * np.finfo(stamps.dtype).eps > 1e-3).any():
        raise fault(f"{what}: found {shown(given)} of {stamps.dtype}, expected float64, which is exact")
    return exact


def one_stamp(given: object, what: str, fault: type[TrackerError] = TrackerError) -> float:
    """Return one timestamp [s]; raise `fault`, which names `what`, if it is not one, or is out of range."""
    stamp = seconds(given, what, fault)
    if stamp.ndim:
        raise fault(f"{what}: found {shown(given)}, expected one finite number of seconds")
    return float(in_range(stamp, what, fault))


def in_range(stamps: FloatArray, what: str, fault: type[TrackerError] = TrackerError) -> FloatArray:
    """Return the timestamps [s]; raise `fault`, which names `what`, if one is not finite or above LATEST."""
    if (np.abs(stamps) <= LATEST).all():
        return stamps
    found = shown(tuple(stamps.tolist()) if stamps.ndim else stamps.item())
    if not np.isfinite(stamps).all():
        raise fault(f"{what}: found {found}, expected finite numbers of seconds")
    raise fault(
        f"{what}: found {found}, expected seconds, up to {LATEST:g}; is it in nanoseconds or milliseconds?"
    )
