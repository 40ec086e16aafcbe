"""From the frames of a workload to figures. Errors are of the poses given; shares [%] are of all frames."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import chi2

import tracker
from benchmarks.data.sets import BINS
from benchmarks.data.workloads import BINS as BINS_WORKLOAD
from benchmarks.score.errors import diameter
from benchmarks.score.shares import SURE, brier_score, mean, median, percent, quantile, reliability, within
from tracker.conventions import Array
from tracker.errors import TrackerError

FREEDOM = 6
"""Degrees of freedom of a pose's error; an honest NEES has the median 5.35 of their χ²."""

ELLIPSOIDS = {50: chi2.ppf(0.5, FREEDOM), 90: chi2.ppf(0.9, FREEDOM), 95: chi2.ppf(0.95, FREEDOM)}
"""Greatest NEES inside the stated ellipsoid of so many per cent."""

THRESHOLDS = np.arange(0.05, 0.51, 0.05)
"""Of ADD and MSSD as shares of the object's diameter, for the average recall."""

PIXEL_THRESHOLDS = np.arange(5.0, 51.0, 5.0)
"""Of MSPD [px] in an image 640 px wide, for the average recall."""

WIDTH = 270
"""Of the images [px]."""


def accuracy_rows(frames: pd.DataFrame) -> list[dict[str, Any]]:
    """Rows of the parts `accuracy`, `visibility` and `confidence` by workload and object."""
    rows: list[dict[str, Any]] = []
    for (workload, name), own in frames.groupby(["workload", "object"], sort=False):
        if workload == BINS_WORKLOAD:
            own = pd.concat([frames[(frames.workload == "realistic") & (frames.object == name)], own])
        about = {"object": name, "group": workload}
        rows.append({"part": "accuracy", **about, **summarise(own)})
        own = own[own.present]
        if len(own):
            rows += [{"part": "visibility", **about, **row} for row in by_visibility(own)]
            given = own[own.found]
            stated = reliability(given.confidence.to_numpy(), _right(given))
            rows += [{"part": "confidence", **about, **row} for row in stated]
    return rows


def summarise(own: pd.DataFrame) -> dict[str, Any]:
    """Figures of one object in one workload, `n` the number of frames."""
    if not own.present.any():
        return {"n": len(own), "false_finds": int(own.found.sum())}
    found, right = own.found.to_numpy(bool), _right(own)
    given = own[own.found]
    result: dict[str, Any] = {"n": len(own)}
    for key, unit in (("position_mm", "mm"), ("rotation_deg", "deg")):
        result |= {f"{n}_{unit}": quantile(given[key], q) for n, q in _QUANTILES.items()}
    for key in ("axis_deg", "roll_deg", "add_mm", "mssd_mm", "mspd_px", "nees"):
        result[f"median_{key}"] = median(given[key])
    for key in ("task_position_error", "task_rotation_error"):
        result[f"mean_{key}"] = mean(given[key])
    sure = own.confidence.fillna(0).to_numpy() > SURE
    result |= {
        "within_1": percent(_within(own, 1, 1)),
        "within_5": percent(right),
        "misses": percent(~found),
        "wrong": percent(found & ~right),
        "wrong_and_sure": percent(found & ~right & sure),
    }
    result |= _seen(own)
    result |= _recalls(own)
    result |= {f"inside_{share}": percent(given.nees <= limit) for share, limit in ELLIPSOIDS.items()}
    result["brier"] = brier_score(given.confidence.to_numpy(), right[found])
    result |= _bounds(given)
    result |= {
        "median_ms": median(own.milliseconds),
        "time_ratio": median(own.milliseconds / own.reference_ms),
        "visible": percent(own.visible_fraction),
    }
    return result


_QUANTILES = {"median": 0.5, "p90": 0.9, "p99": 0.99}


def _within(own: pd.DataFrame, millimetres: float, degrees: float) -> Array:
    return within(own[["position_mm", "rotation_deg"]].to_numpy(), millimetres, degrees)


def _right(own: pd.DataFrame) -> Array:
    return _within(own, 5, 5)


def _seen(own: pd.DataFrame) -> dict[str, float]:
    """Shares of the frames in which enough is visible."""
    half, clear = own[own.visible_fraction >= 0.5], own[own.visible_fraction >= 0.7]
    some = own[(own.visible_fraction >= 0.3) & (own.visible_fraction < 0.5)]
    near = _within(clear, 20, 5)
    return {
        "within_5_seen_30_50": percent(_right(some)),
        "within_5_seen_50": percent(_right(half)),
        "within_5_seen_70": percent(_right(clear)),
        "near_or_ambiguous_seen_70": percent(near | (clear.status == "ambiguous")),
        "far_and_sure_seen_70": percent((clear.confidence.fillna(0).to_numpy() > SURE) & ~near),
    }


def by_visibility(own: pd.DataFrame) -> list[dict[str, Any]]:
    """For each of BINS that holds any: share within 5 mm and 5° [%], misses [%], median errors."""
    rows = []
    for low, high in BINS:
        part = own[(own.visible_fraction >= low) & ((own.visible_fraction < high) | (high == 1.0))]
        if len(part):
            rows.append(
                {
                    "bin": f"{low:g}-{high:g}",
                    "n": len(part),
                    "within_5": percent(_right(part)),
                    "misses": percent(~part.found.to_numpy(bool)),
                    "median_mm": median(part.position_mm),
                    "median_deg": median(part.rotation_deg),
                }
            )
    return rows


def _recalls(own: pd.DataFrame) -> dict[str, float]:
    try:
        length = 1e3 * diameter(tracker.load_object(own.object.iloc[0]).size)
    except TrackerError:  # a box of a rig
        return {}
    pixels = PIXEL_THRESHOLDS * WIDTH / 640
    return {
        "add_recall": 100 * average_recall(own.add_mm, np.array([0.1 * length])),
        "ar_add": 100 * average_recall(own.add_mm, THRESHOLDS * length),
        "ar_mssd": 100 * average_recall(own.mssd_mm, THRESHOLDS * length),
        "ar_mspd": 100 * average_recall(own.mspd_px, pixels),
    }


def average_recall(errors: Array, thresholds: Array) -> float:
    """Mean over thresholds (T,) of the share of errors (N,) below them; nan is a miss."""
    return float(np.mean(np.asarray(errors)[:, None] < thresholds))


def _bounds(given: pd.DataFrame) -> dict[str, float]:
    """Bounds, and the errors as multiples of them: ratio of the medians, and median of the ratios."""
    result: dict[str, float] = {}
    for key in ("bound", "bound_fixed"):
        for unit, error in (("mm", "position_mm"), ("deg", "rotation_deg")):
            use = given[np.isfinite(given[f"{key}_{unit}"])]
            if len(use):
                bound = use[f"{key}_{unit}"]
                result |= {
                    f"{key}_{unit}": median(bound),
                    f"{key}_ratio_{unit}": median(use[error]) / median(bound),
                    f"{key}_median_ratio_{unit}": median(use[error] / bound),
                }
    return result
