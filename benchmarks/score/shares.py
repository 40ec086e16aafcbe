"""Medians, shares and how sure they are, and stated probabilities against what came true."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.stats import binomtest

from tracker.conventions import Array

RIGHT_MM, RIGHT_DEG = 5.0, 5.0
"""A pose counts as right within these errors [mm], [°]."""

SURE = 0.5
"""Confidence above which a wrong pose is wrong and sure."""

CONFIDENCE_BINS = np.array([0.0, 0.1, 0.3, 0.5, 0.7, 0.9, 0.95, 0.98, 0.99, 1.0])
"""Borders of the reliability curve's bins."""


def within(errors: Array, millimetres: float = RIGHT_MM, degrees: float = RIGHT_DEG) -> Array:
    """(N,) whether errors (N, 2) [mm], [°] are within these; nan is not."""
    return np.asarray((np.asarray(errors, dtype=np.float64) <= (millimetres, degrees)).all(axis=1))


def quantile(values: Array, q: float) -> float:
    """Of the finite ones; nan of none."""
    values = np.asarray(values, dtype=np.float64)
    values = values[np.isfinite(values)]
    return float(np.quantile(values, q)) if len(values) else float("nan")


def median(values: Array) -> float:
    """Of the finite ones; nan of none."""
    return quantile(values, 0.5)


def mean(values: Array) -> float:
    """Of all; nan of none."""
    return float(np.mean(values)) if len(values) else float("nan")


def percent(flags: Array) -> float:
    """Share [%] of flags that are set; nan of none."""
    return 100 * mean(flags)


def interval(share: float, count: int) -> tuple[float, float]:
    """Wilson's interval [%] in which a share [%] of so many lies with 95 % confidence."""
    if count == 0:
        return 0.0, 100.0
    found = binomtest(round(share * count / 100), count).proportion_ci(method="wilson")
    return 100 * float(found.low), 100 * float(found.high)


def brier_score(confidence: Array, right: Array) -> float:
    """Mean square of confidence minus outcome; 0 is best, 0.25 what always saying ½ gives."""
    return mean((np.asarray(confidence) - np.asarray(right, dtype=np.float64)) ** 2)


def reliability(
    confidence: Array, right: Array, borders: Sequence[float] | Array = CONFIDENCE_BINS
) -> list[dict[str, Any]]:
    """For each bin of confidence that holds any: `bin`, `n`, mean `confidence` [%], `right` [%]."""
    confidence = np.asarray(confidence, dtype=np.float64)
    place = np.clip(np.searchsorted(borders, confidence, side="right") - 1, 0, len(borders) - 2)
    rows = []
    for k, (low, high) in enumerate(itertools.pairwise(borders)):
        own = place == k
        if own.any():
            about = {"bin": f"{low:g}-{high:g}", "n": int(own.sum())}
            rows.append(about | {"confidence": percent(confidence[own]), "right": percent(right[own])})
    return rows
