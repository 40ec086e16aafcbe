"""Checks of goals and states."""

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from tracker.checks import array_of
from tracker.conventions import FloatArray
from tracker.errors import TaskError, shown

LARGEST = 1e100
"""Largest absolute value of a number, far above any that makes sense; its square does not overflow."""

SHORTEST = 1e-9
"""Smallest length of a quaternion, far above rounding errors."""


def numbers(name: str, value: Any, *, finite: bool = False) -> FloatArray:
    """Return a number or array in double precision; TaskError if any is too large or, if `finite`, NaN."""
    found = array_of(value)
    if found.dtype.kind not in "iuf":
        raise TaskError(f"{name}: found {shown(value)}, expected numbers")
    result: FloatArray = found.astype(np.float64)
    bad = ~(np.abs(result) <= LARGEST) & (finite | ~np.isnan(result))
    if bad.any():
        raise TaskError(f"{name}: found {result[bad][0]}, expected finite numbers up to {LARGEST:g}")
    return result


def vectors(name: str, value: npt.ArrayLike, width: int = 3, *, finite: bool = False) -> FloatArray:
    """Return vectors (..., width); TaskError if malformed."""
    array = numbers(name, value, finite=finite)
    if array.ndim == 0 or array.shape[-1] != width:
        raise TaskError(f"{name}: found shape {array.shape}, expected (..., {width})")
    return array


def quaternions(name: str, value: npt.ArrayLike, *, finite: bool = False) -> FloatArray:
    """Return orientations (..., 4) xyzw, scaled to length 1; TaskError if malformed."""
    array = vectors(name, value, 4, finite=finite)
    length = np.linalg.norm(array, axis=-1, keepdims=True)
    if (length < SHORTEST).any():
        raise TaskError(f"{name}: found a quaternion of length 0, expected a unit quaternion (x, y, z, w)")
    return np.asarray(array / length)


def pair(
    what: str, read: Callable[..., FloatArray], goal: npt.ArrayLike, actual: npt.ArrayLike
) -> tuple[FloatArray, FloatArray]:
    """Return goals and states as read by `read`; TaskError if malformed or if shapes do not broadcast."""
    first, second = read(f"goal_{what}", goal, finite=True), read(what, actual)
    check_fit(f"goal_{what}", first.shape, what, second.shape)
    return first, second


def check_fit(name: str, shape: tuple[int, ...], other: str, other_shape: tuple[int, ...]) -> None:
    """Raise TaskError if shapes do not broadcast."""
    try:
        np.broadcast_shapes(shape, other_shape)
    except ValueError:
        found = f"found shapes {shape} and {other_shape}"
        raise TaskError(f"{name} and {other}: {found}, expected leading axes that broadcast") from None
