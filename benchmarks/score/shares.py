"""Quantiles and shares, with confidence intervals."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import binomtest

SURE = 0.5
"""Confidence above which a wrong pose counts as wrong and sure."""

RESAMPLES = 999


def quantile(values: Any, q: float) -> float:
    """Return a quantile of the finite values; nan if there are none."""
    values = np.asarray(values, dtype=np.float64)
    values = values[np.isfinite(values)]
    return float(np.quantile(values, q)) if len(values) else float("nan")


def median(values: Any) -> float:
    """Return the median of the finite values; nan if there are none."""
    return quantile(values, 0.5)


def mean(values: Any) -> float:
    """Return the mean of all values; nan if there are none."""
    return float(np.mean(values)) if len(values) else float("nan")


def percent(flags: Any) -> float:
    """Return the share of flags that are set [%]; nan if there are none."""
    return 100 * mean(np.asarray(flags))


def wilson_interval(share: float, count: int) -> tuple[float, float]:
    """Return Wilson's 95 % interval [%] of a share [%] of `count`."""
    if count == 0:
        return 0.0, 100.0
    found = binomtest(round(share * count / 100), count).proportion_ci(method="wilson")
    return 100 * float(found.low), 100 * float(found.high)


def bootstrap_interval(of: Callable[[pd.DataFrame], float], rows: pd.DataFrame) -> tuple[float, float]:
    """Return the 2.5 and 97.5 % quantiles of a figure over bootstrap samples of the rows, of a fixed seed."""
    rng = np.random.default_rng(1)
    drawn = [
        of(rows.iloc[rng.integers(len(rows), size=len(rows))]) for _ in range(RESAMPLES if len(rows) else 0)
    ]
    return quantile(drawn, 0.025), quantile(drawn, 0.975)
