"""Figures of films that were played: what `update` answered frame after frame, a row each."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd

from benchmarks.score.metrics import right
from benchmarks.score.shares import SURE, median, percent
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


def at_rest(poses: FloatArray) -> Array:
    """(N,) whether the object rests, of true poses (N, 3, 4); the first and the last are not known to."""
    shift = np.linalg.norm(np.diff(poses[:, :, 3], axis=0), axis=1)
    turn = np.degrees(
        [so3.angle_between(a, b) for a, b in zip(poses[:-1, :, :3], poses[1:, :, :3], strict=True)]
    )
    still = (shift < STILL_M) & (turn < STILL_DEG)
    return np.asarray(np.r_[False, still] & np.r_[still, False])


def flips(rows: pd.DataFrame) -> float:
    """Rotations of another face that were sure."""
    return float(((rows.deg > FLIPPED_DEG) & (rows.confidence > SURE)).sum())


def losses(rows: pd.DataFrame) -> float:
    """How often an object was lost that had been found."""
    total = 0
    for _, film in rows.groupby("film"):
        lost = (film.status == Status.LOST.value).to_numpy()
        total += int(np.count_nonzero(lost[1:] & ~lost[:-1]))
    return float(total)


def over_single(unit: str) -> Callable[[pd.DataFrame], float]:
    """Median error of the filtered pose over that of `detect` on the same frames."""
    return lambda rows: median(rows[unit]) / median(rows[f"single_{unit}"])


def seen_share(flags: Callable[[Array, Array], Array]) -> Callable[[pd.DataFrame], float]:
    """Of frames in which one camera sees enough: the share [%] of what flags say of (near, no pose)."""

    def of(rows: pd.DataFrame) -> float:
        own = rows[rows.visible >= SEEN]
        return percent(flags(right(own, "measured_", NEAR_MM), ~own.measured_given.to_numpy(bool)))

    return of


def longest_wait(rows: pd.DataFrame) -> float:
    """The most frames in a row without a pose, counted from the last of CLEAR_FRAMES clear ones on."""
    worst = 0
    for _, film in rows.groupby("film"):
        clear = wait = 0
        for visible, given in zip(film.visible, film.measured_given, strict=True):
            clear = clear + 1 if visible >= CLEAR else 0
            wait = wait + 1 if clear >= CLEAR_FRAMES and not given else 0
            worst = max(worst, wait)
    return float(worst)


def vanished(name: str) -> Callable[[pd.DataFrame], float]:
    """A figure of acts in which the object vanishes and comes back; each act is a film of its own.

    `kept`: frames after COAST with a pose all the same; `invented`: frames in which one was measured;
    `longest_wait`: frames until it is found again, the one of its return included.
    """

    def of(rows: pd.DataFrame) -> float:
        found = [_act(act) for _, act in rows.groupby("film")]
        return float((max if name == "longest_wait" else sum)(act[name] for act in found))

    return of


def _act(act: pd.DataFrame) -> dict[str, Any]:
    away = np.flatnonzero(~act.present)
    stamps = act.timestamp.to_numpy()
    # It was there for the last time, at most, one frame before.
    absent = stamps[away] - stamps[away[0] - 1]
    back = np.flatnonzero(right(act, "measured_")[away[-1] + 1 :])
    return {
        "kept": int(np.count_nonzero(act.found.to_numpy(bool)[away] & (absent > COAST))),
        "invented": int(act.measured_given.to_numpy(bool)[away].sum()),
        "longest_wait": int(back[0]) + 1 if len(back) else len(act) - int(away[-1]),
    }
