"""Two runs on the same scenes, compared scene by scene."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import binomtest, bootstrap

from benchmarks.judge.results import Results, ResultsError
from benchmarks.score.shares import SURE, within

KEYS = ["workload", "object", "index"]

ERRORS = {"mm": "position_mm", "deg": "rotation_deg"}

_RESAMPLES = 999


def compare(before: Results, after: Results) -> list[dict[str, Any]]:
    """Rows of the part `compared`, one for each workload and object that both runs have.

    `ratio_…` is the median of the errors' ratios, after over before, of scenes in which both found a pose,
    with its 95 % bootstrap interval `low_…`, `high_…`; `p_…` says how likely a fair coin is to be as
    lopsided as the signs of the differences. `gained` and `lost` are scenes within 5 mm and 5° in one run
    alone, `p_right` the same for them; `sure_wrong_before` and `_after` count wrong and sure poses.

    Raises:
        ResultsError: the runs are of other scenes, or have none in common.
    """
    for key in ("seed", "draw"):
        if before.about.get(key) != after.about.get(key):
            raise ResultsError(
                f"runs of other scenes: found {key} {after.about.get(key)}, expected {before.about.get(key)}"
            )
    pairs = before.frames.merge(after.frames, on=KEYS, suffixes=("_before", "_after"))
    pairs = pairs[pairs.present_before]
    if pairs.empty:
        raise ResultsError("found no scene that both runs have")
    groups = pairs.groupby(["workload", "object"], sort=False)
    return [
        {"part": "compared", "group": workload, "object": name, **_row(own)}
        for (workload, name), own in groups
    ]


def _row(own: pd.DataFrame) -> dict[str, Any]:
    row: dict[str, Any] = {"n": len(own)}
    both = own[own.found_before & own.found_after]
    for unit, key in ERRORS.items():
        row |= paired(both[f"{key}_before"].to_numpy(), both[f"{key}_after"].to_numpy(), unit)
    right = {when: _right(own, when) for when in ("before", "after")}
    gained, lost = (
        int((right["after"] & ~right["before"]).sum()),
        int((right["before"] & ~right["after"]).sum()),
    )
    row |= {"gained": gained, "lost": lost, "p_right": _sign_test(gained, lost)}
    for when, is_right in right.items():
        sure = own[f"confidence_{when}"].fillna(0).to_numpy() > SURE
        row[f"sure_wrong_{when}"] = int((sure & ~is_right).sum())
    return row


def paired(before: Any, after: Any, unit: str) -> dict[str, float]:
    """Median ratio of errors (N,), its interval, and the sign test, with names that end in the unit."""
    if not len(before):
        return {}
    ratios = np.log(np.maximum(after, 1e-12) / np.maximum(before, 1e-12))
    low = high = middle = float(np.median(ratios))
    if np.ptp(ratios) > 0 and len(ratios) > 1:
        found = bootstrap(
            (ratios,),
            np.median,
            vectorized=True,
            n_resamples=_RESAMPLES,
            method="percentile",
            random_state=np.random.default_rng(1),
        ).confidence_interval
        low, high = float(found.low), float(found.high)
    named = {"ratio": middle, "low": low, "high": high}
    worse, better = int((ratios > 0).sum()), int((ratios < 0).sum())
    return {f"{key}_{unit}": float(np.exp(value)) for key, value in named.items()} | {
        f"p_{unit}": _sign_test(worse, better)
    }


def _sign_test(one: int, other: int) -> float:
    return float(binomtest(one, one + other).pvalue) if one + other else 1.0


def _right(own: pd.DataFrame, when: str) -> Any:
    return within(own[[f"{key}_{when}" for key in ERRORS.values()]].to_numpy())
