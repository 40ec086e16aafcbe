"""Figures of films that were played; frames are rows of data frames."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from benchmarks.data.films import ABSENT
from benchmarks.score.shares import SURE, median, percent, quantile, within
from benchmarks.score.summary import ELLIPSOIDS
from tracker import Status
from tracker.conventions import Array, FloatArray
from tracker.geometry import so3
from tracker.tracking.belief import TrackingOptions

STILL_M, STILL_DEG = 1e-5, 0.01
"""An object that moved less since the frame before, and until the next one, is at rest [m], [°]."""

FLIPPED_DEG = 30.0
"""A rotation that is farther off is that of another face [°]."""

NEAR_MM = 20.0
"""One camera's pose counts as right within so much and 5° [mm]."""

SEEN, CLEAR, CLEAR_FRAMES = 0.5, 0.7, 3
"""Visible fractions from which one camera is judged, and from which on for so many frames it ought to find
what it had lost."""

COAST = TrackingOptions().coast_seconds
"""For so long the pose of an object that vanished may be predicted [s]."""

COLUMNS = (
    *("film", "timestamp", "present", "status", "confidence", "update_ms", "reference_ms", "at_rest"),
    *(f"{pose}_{unit}" for pose in ("measured", "filtered") for unit in ("given", "mm", "deg", "nees")),
)
"""Of a frame that was given to `update`: number of the film, time stamp [s], whether there is an object, name
of `tracker.Status`, confidence of the filtered pose, times of `update` and of the reference work after it,
whether the object rests, and of both poses whether there was one, and its errors; `visible_0` … beside."""


def at_rest(poses: FloatArray) -> Array:
    """(N,) whether the object rests, of true poses (N, 3, 4); the first and the last are not known to."""
    shift = np.linalg.norm(np.diff(poses[:, :, 3], axis=0), axis=1)
    turn = np.degrees(
        [so3.angle_between(a, b) for a, b in zip(poses[:-1, :, :3], poses[1:, :, :3], strict=True)]
    )
    still = (shift < STILL_M) & (turn < STILL_DEG)
    return np.asarray(np.r_[False, still] & np.r_[still, False])


def right(frames: pd.DataFrame, pose: str, millimetres: float = 5.0) -> Array:
    """(N,) whether the measured or filtered pose is within so many millimetres and 5°."""
    return within(frames[[f"{pose}_mm", f"{pose}_deg"]].to_numpy(), millimetres)


def losses(status: Array) -> int:
    """How often an object was lost that had been found."""
    lost = np.asarray(status) == Status.LOST.name
    return int(np.count_nonzero(lost[1:] & ~lost[:-1]))


def share_row(frames: pd.DataFrame) -> dict[str, Any]:
    """Right answers [%], flips and losses of several films."""
    flipped = (frames.filtered_deg > FLIPPED_DEG) & (frames.confidence > SURE)
    return {
        "n": len(frames),
        "filtered": percent(right(frames, "filtered")),
        "measured": percent(right(frames, "measured")),
        "flips": int(flipped.sum()),
        "losses": sum(losses(own.status) for _, own in frames.groupby("film")),
        "median_nees": median(frames.filtered_nees),
        **{
            f"inside_{share}": percent(frames.filtered_nees[frames.filtered_given] <= limit)
            for share, limit in ELLIPSOIDS.items()
        },
    }


def status_row(frames: pd.DataFrame) -> dict[str, int]:
    """Frames by status."""
    counts = frames.status.str.lower().str.replace("_", " ").value_counts()
    return {"n": len(frames)} | {str(name): int(count) for name, count in counts.sort_index().items()}


def state_rows(frames: pd.DataFrame, single: pd.DataFrame) -> list[dict[str, Any]]:
    """Errors at rest and moving, beside those of the same frames without memory (columns mm, deg)."""
    rows = []
    for state, own in (("at rest", frames.at_rest), ("moving", ~frames.at_rest)):
        row: dict[str, Any] = {"group": state, "n": int(own.sum())}
        for unit in ("mm", "deg"):
            now = median(frames[f"filtered_{unit}"][own])
            once = median(single[unit][own])
            row |= {f"filtered_{unit}": now, f"single_{unit}": once, f"ratio_{unit}": now / once}
        rows.append(row)
    return rows


def camera_row(frames: pd.DataFrame, camera: int) -> dict[str, Any]:
    """What is measured by one camera alone, of frames in which it sees enough: shares in %."""
    own = frames[frames[f"visible_{camera}"] >= SEEN]
    near, none = right(own, "measured", NEAR_MM), ~own.measured_given.to_numpy(bool)
    return {
        "group": f"camera {camera + 1}",
        "n": len(own),
        "right": percent(near),
        "none": percent(none),
        "wrong": percent(~near & ~none),
        "right_or_none": percent(near | none),
        "longest_wait": max(
            longest_wait(film[f"visible_{camera}"].to_numpy(), film.measured_given.to_numpy(bool))
            for _, film in frames.groupby("film")
        ),
    }


def longest_wait(visible: FloatArray, given: Array) -> int:
    """The most frames in a row without a pose, counted from the last of CLEAR_FRAMES clear ones on."""
    worst = clear = wait = 0
    for fraction, is_given in zip(visible, given, strict=True):
        clear = clear + 1 if fraction >= CLEAR else 0
        wait = wait + 1 if clear >= CLEAR_FRAMES and not is_given else 0
        worst = max(worst, wait)
    return worst


def vanished_row(acts: pd.DataFrame) -> dict[str, Any]:
    """What was said while the object was away, and when it was back; each act is a film of its own."""
    late, kept, invented, waits, longest = 0, 0, 0, [], 0.0
    for _, act in acts.groupby("film"):
        away = np.flatnonzero(~act.present)
        stamps, given = act.timestamp.to_numpy(), act.filtered_given.to_numpy(bool)[away]
        # It was there for the last time, at most, one frame before.
        absent = stamps[away] - stamps[away[0] - 1]
        late += int(np.count_nonzero(absent > COAST))
        kept += int(np.count_nonzero(given & (absent > COAST)))
        longest = max([longest, *absent[given].tolist()])
        invented += int(act.measured_given.to_numpy(bool)[away].sum())
        found = np.flatnonzero(right(act, "measured")[away[-1] + 1 :])
        # The frame of the return itself counts as one.
        waits.append(int(found[0]) + 1 if len(found) else len(act) - int(away[-1]))
    return {
        "n": len(waits),
        "absent_frames": ABSENT * len(waits),
        "late_frames": late,
        "kept": kept,
        "kept_seconds": longest,
        "invented": invented,
        "median_wait": float(np.median(waits)),
        "longest_wait": max(waits),
    }


def speed_row(frames: pd.DataFrame) -> dict[str, Any]:
    """What an update costs while the object is tracked."""
    own = frames[frames.status == Status.TRACKING.name]
    middle, p99 = median(own.update_ms), quantile(own.update_ms, 0.99)
    return {
        "n": len(own),
        "median_ms": middle,
        "p99_ms": p99,
        "ratio": median(own.update_ms / own.reference_ms),
        "p99_over_median": p99 / middle,
    }
