"""Figures for played films, from rows with the answer of `update` to each frame."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd

from benchmarks.score.metrics import SURE, median, percent, right
from tracker import Status
from tracker.conventions import Array, FloatArray
from tracker.geometry import so3
from tracker.tracking.belief import TrackingOptions

STILL_M, STILL_DEG = 1e-5, 0.01
"""An object is at rest if it moves less than this [m], [°] both from the previous and to the next frame."""

FLIPPED_DEG = 30.0
"""Rotation error above which the pose takes one face for another [°]."""

NEAR_MM = 20.0
"""Position error within which one camera's pose counts as right, if it is also within 5° [mm]."""

SEEN, CLEAR, CLEAR_FRAMES = 0.5, 0.7, 3
"""Visible fractions: one camera is judged from the first on; after CLEAR_FRAMES frames at or above the
second, it ought to find an object that it had lost."""

COAST = TrackingOptions().coast_seconds
"""Time for which the pose of a vanished object may be predicted [s]."""


def at_rest(poses: FloatArray) -> Array:
    """Return (N,) whether the object is at rest, from true poses (N, 3, 4); False for the first and last."""
    shift = np.linalg.norm(np.diff(poses[:, :, 3], axis=0), axis=1)
    turn = np.degrees(so3.angle_between(poses[:-1, :, :3], poses[1:, :, :3]))
    still = (shift < STILL_M) & (turn < STILL_DEG)
    return np.asarray(np.r_[False, still] & np.r_[still, False])


def flips(rows: pd.DataFrame) -> float:
    """Return the number of confident poses that take one face for another."""
    return float(((rows.deg > FLIPPED_DEG) & (rows.confidence > SURE)).sum())


def losses(rows: pd.DataFrame) -> float:
    """Return how often an object was lost after it had been found."""
    total = 0
    for _, film in rows.groupby("film"):
        lost = (film.status == Status.LOST.value).to_numpy()
        total += int(np.count_nonzero(lost[1:] & ~lost[:-1]))
    return float(total)


def single(rows: pd.DataFrame) -> float:
    """Return the share of frames that `detect` alone gets right [%]; nan if it was not called."""
    return percent(right(rows, "single_")) if rows.single_mm.notna().any() else math.nan


def over_single(unit: str) -> Callable[[pd.DataFrame], float]:
    """Return a function for the median error of the filtered pose relative to `detect` on the same frames."""

    def ratio(rows: pd.DataFrame) -> float:
        both = rows.dropna(subset=[unit, f"single_{unit}"])
        return median(both[unit]) / median(both[f"single_{unit}"])

    return ratio


def seen_share(flags: Callable[[Array, Array], Array]) -> Callable[[pd.DataFrame], float]:
    """Return a function for the share [%] of flags(near, no pose) over frames visible from SEEN on."""

    def of(rows: pd.DataFrame) -> float:
        own = rows[rows.visible >= SEEN]
        return percent(flags(right(own, "measured_", NEAR_MM), ~own.measured_given.to_numpy(bool)))

    return of


def longest_wait(rows: pd.DataFrame) -> float:
    """Return the largest number of consecutive frames without a pose, after CLEAR_FRAMES clear ones."""
    worst = 0
    for _, film in rows.groupby("film"):
        clear = wait = 0
        for visible, given in zip(film.visible, film.measured_given, strict=True):
            clear = clear + 1 if visible >= CLEAR else 0
            wait = wait + 1 if clear >= CLEAR_FRAMES and not given else 0
            worst = max(worst, wait)
    return float(worst)


def vanished(name: str) -> Callable[[pd.DataFrame], float]:
    """Return a function for a figure over films in which the object vanishes and comes back.

    `kept`: absent frames that still have a pose after COAST; `invented`: those with a measured pose;
    `longest_wait`: frames until it is found again, including the one in which it returns.
    """

    def of(rows: pd.DataFrame) -> float:
        found = [_act(act) for _, act in rows.groupby("film")]
        return float((max if name == "longest_wait" else sum)(act[name] for act in found))

    return of


def _act(act: pd.DataFrame) -> dict[str, Any]:
    away = np.flatnonzero(~act.present)
    stamps = act.timestamp.to_numpy()
    # The object was last present one frame before.
    absent = stamps[away] - stamps[away[0] - 1]
    back = np.flatnonzero(right(act, "measured_")[away[-1] + 1 :])
    return {
        "kept": int(np.count_nonzero(act.found.to_numpy(bool)[away] & (absent > COAST))),
        "invented": int(act.measured_given.to_numpy(bool)[away].sum()),
        "longest_wait": int(back[0]) + 1 if len(back) else len(act) - int(away[-1]),
    }
