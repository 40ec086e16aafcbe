"""Quantiles and shares, and how sure they are."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import binomtest

from tracker.conventions import Array

RIGHT_MM, RIGHT_DEG = 5.0, 5.0
"""A pose counts as right within these errors [mm], [°]."""

SURE = 0.5
"""Confidence above which a wrong pose is wrong and sure."""

RESAMPLES = 999


def within(errors: Array, millimetres: float = RIGHT_MM, degrees: float = RIGHT_DEG) -> Array:
    """(N,) whether errors (N, 2) [mm], [°] are within these; nan is not."""
    return np.asarray((np.asarray(errors, dtype=np.float64) <= (millimetres, degrees)).all(axis=1))


def quantile(values: Any, q: float) -> float:
    """Of the finite ones; nan of none."""
    values = np.asarray(values, dtype=np.float64)
    values = values[np.isfinite(values)]
    return float(np.quantile(values, q)) if len(values) else float("nan")


def median(values: Any) -> float:
    """Of the finite ones; nan of none."""
    return quantile(values, 0.5)


def mean(values: Any) -> float:
    """Of all; nan of none."""
    return float(np.mean(values)) if len(values) else float("nan")


def percent(flags: Any) -> float:
    """Share [%] of flags that are set; nan of none."""
    return 100 * mean(np.asarray(flags))


def wilson_interval(share: float, count: int) -> tuple[float, float]:
    """Wilson's interval [%] in which a share [%] of so many lies with 95 % confidence."""
    if count == 0:
        return 0.0, 100.0
    found = binomtest(round(share * count / 100), count).proportion_ci(method="wilson")
    return 100 * float(found.low), 100 * float(found.high)


def bootstrap_interval(of: Callable[[pd.DataFrame], float], rows: pd.DataFrame) -> tuple[float, float]:
    """The 2.5 and 97.5 % quantiles of a figure over resampled rows; the resamples are seeded."""
    rng = np.random.default_rng(1)
    drawn = [
        of(rows.iloc[rng.integers(len(rows), size=len(rows))]) for _ in range(RESAMPLES if len(rows) else 0)
    ]
    return quantile(drawn, 0.025), quantile(drawn, 0.975)
