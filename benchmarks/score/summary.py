"""From records to figures. Errors are of the poses given; shares are of all frames with an object."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np

import tracker
from benchmarks.data.workloads import BINS
from benchmarks.score.errors import diameter
from benchmarks.score.records import FrameRecord, column
from tracker.conventions import Array, FloatArray

SURE = 0.5
"""Confidence above which a wrong pose is wrong and sure."""

CHI2_MEDIAN = 5.348
"""Median of χ² with 6 degrees of freedom: that of an honest NEES."""

THRESHOLDS = np.arange(0.05, 0.51, 0.05)
"""Of ADD and MSSD as shares of the object's diameter, for the average recall."""

PIXEL_THRESHOLDS = np.arange(5.0, 51.0, 5.0)
"""Of MSPD [px] in an image 640 px wide, for the average recall."""

WIDTH = 270
"""Of the images [px]."""

CONFIDENCE_BINS = np.array([0.0, 0.1, 0.3, 0.5, 0.7, 0.9, 0.95, 0.98, 0.99, 1.0])
"""Borders of the reliability curve's bins."""


def within(records: Sequence[FrameRecord], millimetres: float, degrees: float) -> Array:
    """(N,) whether the pose is that near to the truth; frames without a pose are not."""
    position, rotation = column(records, "position_mm"), column(records, "rotation_deg")
    # Comparisons with nan are False.
    return np.asarray((position <= millimetres) & (rotation <= degrees))


def summarise(records: Sequence[FrameRecord]) -> dict[str, Any]:
    """Figures of one object in one workload; shares in %."""
    if not records:
        return {"frames": 0}
    if not any(record.present for record in records):
        return {"frames": len(records), "false_finds": int(column(records, "found").sum())}
    found = column(records, "found").astype(bool)
    right = within(records, 5, 5)
    confidence = np.nan_to_num(column(records, "confidence"))
    result: dict[str, Any] = {"frames": len(records)}
    for key, unit in (("position_mm", "mm"), ("rotation_deg", "deg")):
        values = column(records, key)[found]
        for name, q in (("median", 0.5), ("p90", 0.9), ("p99", 0.99)):
            result[f"{name}_{unit}"] = _quantile(values, q)
    for key in ("axis_deg", "roll_deg", "add_mm", "mssd_mm", "mspd_px", "nees"):
        result[f"median_{key}"] = _quantile(column(records, key)[found], 0.5)
    for key in ("task_position_error", "task_rotation_error"):
        result[f"mean_{key}"] = _mean(column(records, key)[found])
    result |= {
        "within_1": percent(within(records, 1, 1)),
        "within_5": percent(right),
        "misses": percent(~found),
        "wrong": percent(found & ~right),
        "wrong_and_sure": percent(found & ~right & (confidence > SURE)),
    }
    result |= _recalls(records)
    result |= _calibration(confidence[found], right[found])
    result |= _bounds(records)
    result["bins"] = by_visibility(records)
    result["median_ms"] = _quantile(column(records, "milliseconds"), 0.5)
    return result


def by_visibility(records: Sequence[FrameRecord]) -> list[dict[str, float]]:
    """For each of BINS: frames, share within 5 mm and 5° [%], misses [%], median errors."""
    visible = column(records, "visible_fraction")
    rows = []
    for low, high in BINS:
        part = [r for r, v in zip(records, visible, strict=True) if low <= v and (v < high or high == 1.0)]
        found = column(part, "found").astype(bool)
        rows.append(
            {
                "low": low,
                "high": high,
                "frames": len(part),
                "within_5": percent(within(part, 5, 5)),
                "misses": percent(~found),
                "median_mm": _quantile(column(part, "position_mm")[found], 0.5),
                "median_deg": _quantile(column(part, "rotation_deg")[found], 0.5),
            }
        )
    return rows


def _recalls(records: Sequence[FrameRecord]) -> dict[str, float]:
    size = tracker.load_object(records[0].object).size
    length = 1e3 * diameter(size)
    pixels = PIXEL_THRESHOLDS * WIDTH / 640
    return {
        "add_recall": 100 * average_recall(column(records, "add_mm"), np.array([0.1 * length])),
        "ar_add": 100 * average_recall(column(records, "add_mm"), THRESHOLDS * length),
        "ar_mssd": 100 * average_recall(column(records, "mssd_mm"), THRESHOLDS * length),
        "ar_mspd": 100 * average_recall(column(records, "mspd_px"), pixels),
    }


def average_recall(errors: Array, thresholds: Array) -> float:
    """Mean over thresholds (T,) of the share of errors (N,) below them; nan is a miss."""
    return float(np.mean(np.asarray(errors)[:, None] < thresholds))


def brier_score(confidence: Array, right: Array) -> float:
    """Mean square of confidence minus outcome; 0 is best, 0.25 what always saying ½ gives."""
    return _mean((np.asarray(confidence) - np.asarray(right, dtype=np.float64)) ** 2)


def reliability(confidence: Array, right: Array) -> list[dict[str, float]]:
    """For each bin of confidence: its borders, how many, mean confidence, share that is right."""
    rows = []
    place = np.clip(np.searchsorted(CONFIDENCE_BINS, confidence, side="right") - 1, 0, None)
    place = np.minimum(place, len(CONFIDENCE_BINS) - 2)
    for k, (low, high) in enumerate(itertools.pairwise(CONFIDENCE_BINS)):
        own = place == k
        rows.append(
            {
                "low": float(low),
                "high": float(high),
                "count": int(own.sum()),
                "confidence": _mean(np.asarray(confidence)[own]),
                "right": _mean(np.asarray(right)[own]),
            }
        )
    return rows


def _calibration(confidence: Array, right: Array) -> dict[str, Any]:
    return {"brier": brier_score(confidence, right), "reliability": reliability(confidence, right)}


def _bounds(records: Sequence[FrameRecord]) -> dict[str, float]:
    """Bounds, and the errors as multiples of them: ratio of the medians, and median of the ratios."""
    found = column(records, "found").astype(bool)
    result = {}
    for key in ("bound", "bound_fixed"):
        for unit, error in (("mm", "position_mm"), ("deg", "rotation_deg")):
            bound, errors = column(records, f"{key}_{unit}"), column(records, error)
            use = found & np.isfinite(bound)
            result[f"{key}_{unit}"] = _quantile(bound[use], 0.5)
            if use.any():
                result[f"{key}_ratio_{unit}"] = float(np.median(errors[use]) / np.median(bound[use]))
                result[f"{key}_median_ratio_{unit}"] = float(np.median(errors[use] / bound[use]))
    return result


def _quantile(values: FloatArray, q: float) -> float:
    values = values[np.isfinite(values)]
    return float(np.quantile(values, q)) if len(values) else float("nan")


def _mean(values: Array) -> float:
    return float(np.mean(values)) if len(values) else float("nan")


def percent(flags: Array) -> float:
    """Share [%] of flags that are set; nan of none."""
    return 100 * _mean(flags)
