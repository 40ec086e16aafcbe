"""Figures of films that were played: rows of the tables of results."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np

from benchmarks.data.films import ABSENT
from benchmarks.measure.playing import Played
from benchmarks.measure.timing import RIGHT_DEG, RIGHT_MM
from benchmarks.score.summary import SURE, percent
from tracker import Status
from tracker.conventions import Array, FloatArray
from tracker.tracking.belief import TrackingOptions

FLIPPED_DEG = 30.0
"""A rotation that is farther off is that of another face [°]."""

NEAR_MM = 20.0
"""One camera's pose counts as right within so much and RIGHT_DEG [mm]."""

SEEN, CLEAR, CLEAR_FRAMES = 0.5, 0.7, 3
"""Visible fractions from which one camera is judged, and from which on for so many frames it ought to find
what it had lost."""

COAST = TrackingOptions().coast_seconds
"""For so long the pose of an object that vanished may be predicted [s]."""


def within(errors: FloatArray, millimetres: float = RIGHT_MM, degrees: float = RIGHT_DEG) -> Array:
    """(N,) whether errors (N, 2) are within these; nan is not."""
    return np.asarray((errors < (millimetres, degrees)).all(axis=1))


def losses(status: Array) -> int:
    """How often an object was lost that had been found."""
    lost = status == Status.LOST.name
    return int(np.count_nonzero(lost[1:] & ~lost[:-1]))


def share_row(parts: Sequence[Played]) -> dict[str, Any]:
    """Right answers [%], losses and statuses of several films."""
    filtered, measured = (_joined(parts, key) for key in ("filtered", "measured"))
    flipped = (filtered[:, 1] > FLIPPED_DEG) & (_joined(parts, "confidence") > SURE)
    return {
        "frames": len(filtered),
        "filtered": percent(within(filtered)),
        "measured": percent(within(measured)),
        "flips": int(np.count_nonzero(flipped)),
        "losses": sum(losses(part.status) for part in parts),
        "statuses": {key: int(n) for key, n in sorted(Counter(_joined(parts, "status").tolist()).items())},
    }


def whole_row(parts: Sequence[Played], single: FloatArray) -> dict[str, Any]:
    """Figures of whole films, with the errors (N, 2) of the same frames without memory."""
    filtered, at_rest = _joined(parts, "filtered"), _joined(parts, "at_rest")
    row = share_row(parts) | {
        "single": percent(within(single)),
        "nees": _median(_joined(parts, "nees")),
    }
    for state, own in (("rest", at_rest), ("moving", ~at_rest)):
        row[f"{state}_frames"] = int(np.count_nonzero(own))
        for column, unit in enumerate(("mm", "deg")):
            now, once = (_median(errors[own, column]) for errors in (filtered, single))
            row |= {
                f"{state}_filtered_{unit}": now,
                f"{state}_single_{unit}": once,
                f"{state}_ratio_{unit}": now / once,
            }
    return row


def camera_row(parts: Sequence[Played], camera: int) -> dict[str, Any]:
    """What is measured by one camera alone, of frames in which it sees enough: shares in %."""
    own = _joined(parts, "visible")[:, camera] >= SEEN
    right = within(_joined(parts, "measured"), NEAR_MM)[own]
    none = ~_joined(parts, "given")[own, 0]
    return {
        "camera": camera,
        "frames": int(np.count_nonzero(own)),
        "right": percent(right),
        "none": percent(none),
        "wrong": percent(~right & ~none),
        "right_or_none": percent(right | none),
        "longest_wait": max(longest_wait(part.visible[:, camera], part.given[:, 0]) for part in parts),
    }


def longest_wait(visible: FloatArray, given: Array) -> int:
    """The most frames in a row without a pose, counted from the last of CLEAR_FRAMES clear ones on."""
    worst = clear = wait = 0
    for fraction, is_given in zip(visible, given, strict=True):
        clear = clear + 1 if fraction >= CLEAR else 0
        wait = wait + 1 if clear >= CLEAR_FRAMES and not is_given else 0
        worst = max(worst, wait)
    return worst


def vanished_row(acts: Sequence[Played]) -> dict[str, Any]:
    """What was said while the object was away, and when it was back."""
    late, kept, invented, waits, longest = 0, 0, 0, [], 0.0
    for act in acts:
        away = np.flatnonzero(~act.present)
        # It was there for the last time, at most, one frame before.
        absent = act.timestamp[away] - act.timestamp[away[0] - 1]
        late += int(np.count_nonzero(absent > COAST))
        is_kept = act.given[away, 1]
        kept += int(np.count_nonzero(is_kept & (absent > COAST)))
        longest = max([longest, *absent[is_kept].tolist()])
        invented += int(np.count_nonzero(act.given[away, 0]))
        found = np.flatnonzero(within(act.measured)[away[-1] + 1 :])
        # The frame of the return itself counts as one.
        waits.append(int(found[0]) + 1 if len(found) else len(act) - int(away[-1]))
    return {
        "times": len(acts),
        "absent_frames": ABSENT * len(acts),
        "late_frames": late,
        "kept": kept,
        "kept_seconds": longest,
        "invented": invented,
        "median_wait": float(np.median(waits)),
        "longest_wait": max(waits),
    }


def speed_row(parts: Sequence[Played]) -> dict[str, Any]:
    """What an update costs while the object is tracked."""
    own = _joined(parts, "status") == Status.TRACKING.name
    update, reference = _joined(parts, "times")[own].T
    if not len(update):
        update = reference = np.full(1, np.nan)
    median, p99 = float(np.median(update)), float(np.quantile(update, 0.99))
    return {
        "median_ms": median,
        "p99_ms": p99,
        "reference_ms": float(np.median(reference)),
        "ratio": float(np.median(update / reference)),
        "p99_over_median": p99 / median,
        "times": int(np.count_nonzero(own)),
    }


def _joined(parts: Sequence[Played], key: str) -> Array:
    return np.concatenate([getattr(part, key) for part in parts])


def _median(values: Array) -> float:
    values = values[np.isfinite(values)]
    return float(np.median(values)) if len(values) else np.nan
