"""Stamps: moments in seconds on one clock, which may begin anywhere, checked where they come in."""

from __future__ import annotations

import numpy as np

from tracker.conventions import FloatArray
from tracker.errors import TrackerError, shown

LATEST = 1e11
"""Greatest stamp [s], more than three thousand years: a greater one counts nanoseconds or the like."""


def seconds(given: object, what: str, fault: type[TrackerError] = TrackerError) -> FloatArray:
    """Numbers as stamps [s], in their shape; `fault`, which names `what`, where they are none.

    Texts and datetime64 are none: neither says its unit.
    """
    try:
        stamps = np.asarray(given)
    except (TypeError, ValueError):  # a ragged sequence
        stamps = np.asarray(None)
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
