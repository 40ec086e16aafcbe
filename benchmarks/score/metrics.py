"""Figures, each declared once: name, function, format, which direction is better, and what the gate allows.

A metric is computed from the rows of a data frame, one row per answer of the tracker.
`benchmarks.score.tables` chooses the rows. Quantiles and shares have confidence intervals.
"""

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Any, TypeAlias

import numpy as np
import pandas as pd
from scipy.stats import chi2, norm

from tracker.conventions import Array

Rows: TypeAlias = pd.DataFrame

Split = Callable[[Rows], Iterable[tuple[str, Rows]]]
"""Splits rows into bins, by name."""

SLOWER = 2.0
"""Factor by which the gate lets times grow: processors and their other work change those of unchanged code by
up to 1.6, even relative to the reference work. `compare` shows less, of two runs on one machine."""

SURE = 0.5
"""Confidence above which a wrong pose counts as wrong and sure."""

RESAMPLES = 999

FILM = "object", "camera", "film"
"""Columns that tell films apart, where they exist."""

NOTHING = "–"
"""Text for a figure that was not measured."""

ELLIPSOID_95 = float(chi2.ppf(0.95, 6))
"""Largest NEES inside the stated 95 % ellipsoid."""


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
    """Return Wilson's 95 % interval [%] of a share [%] of `count` independent answers, or films."""
    if count == 0:
        return 0.0, 100.0
    # The mean share of whole films is seldom a whole number of them.
    wide = float(norm.ppf(0.975)) ** 2 / count
    middle, odds = share / 100 + wide / 2, share / 100 * (1 - share / 100)
    off = math.sqrt(wide * odds + wide**2 / 4)
    return 100 * max(middle - off, 0.0) / (1 + wide), 100 * min((middle + off) / (1 + wide), 1.0)


def independent(rows: Rows) -> list[Array]:
    """Return the places in `rows` of each independent part: one answer, or all frames of a film."""
    keys = [key for key in FILM if key in rows]
    if "film" not in keys:
        return list(np.arange(len(rows))[:, None])
    return list(rows.groupby(keys, sort=False).indices.values())


def bootstrap_interval(of: Callable[[Rows], float], rows: Rows) -> tuple[float, float]:
    """Return the 2.5 and 97.5 % quantiles of a figure over bootstrap samples, of a fixed seed.

    Answers are drawn, or whole films, whose frames are alike.
    """
    rng, parts = np.random.default_rng(1), independent(rows)
    drawn = [
        of(rows.iloc[np.concatenate([parts[k] for k in rng.integers(len(parts), size=len(parts))])])
        for _ in range(RESAMPLES if parts else 0)
    ]
    return quantile(drawn, 0.025), quantile(drawn, 0.975)


@dataclass(frozen=True)
class Metric:
    """One figure, computed from rows."""

    name: str
    """Name in results."""
    title: str
    """Heading of its column."""
    of: Callable[[Rows], float]
    """The function; returns nan where there is nothing to measure."""
    form: str = "{:.3g}"
    """Format of the figure, with its unit."""
    better: str = "lower"
    """`lower`, `higher`, or `same`: the gate allows no change in either direction."""
    factor: float | None = None
    """Factor by which the gate lets it become worse; None: not checked as a factor."""
    step: float | None = None
    """Difference by which the gate lets it become worse; None: not checked as a difference."""
    share: bool = False
    """Whether it is a share of the rows [%], with Wilson's interval."""
    given: bool = False
    """Whether such a share is of the rows with a pose only."""
    below: float = 0.0
    """Share of the values below the figure, if it is a quantile near the largest."""

    def text(self, value: float | None) -> str:
        """Return the figure as text."""
        return NOTHING if value is None or not math.isfinite(value) else self.form.format(value)

    def interval(self, rows: Rows) -> tuple[float, float]:
        """Return the 95 % confidence interval of the figure."""
        if self.share:
            return wilson_interval(self.of(rows), len(independent(rows[rows.found] if self.given else rows)))
        low, high = bootstrap_interval(self.of, rows)
        # Too few values do not bound a quantile: all of them lie below it with this probability.
        return low, math.inf if self.below ** len(independent(rows)) > 0.025 else high

    def worse(self, before: float, after: float) -> bool:
        """Return whether the figure got worse by more than the gate allows, or is missing now."""
        if math.isnan(before):
            return False
        if math.isnan(after):
            return True
        low, high = before - (self.step or 0.0), before + (self.step or 0.0)
        if self.factor is not None:
            low, high = min(low, before / self.factor), max(high, before * self.factor)
        return (self.better != "lower" and after < low - 1e-9) or (
            self.better != "higher" and after > high + 1e-9
        )


@dataclass(frozen=True)
class Table:
    """Figures from the rows of one part, for each group, object and bin."""

    name: str
    """Name in results."""
    title: str
    text: str
    """Explanation above the table."""
    metrics: tuple[Metric, ...]
    groups: tuple[str, ...] = ("*",)
    """Patterns of the groups to show."""
    without: tuple[str, ...] = ()
    """Patterns of the groups to leave out."""
    split: Split | None = None
    """Splits rows into bins; None: no bins."""
    heads: tuple[str, str, str] = ("object", "", "")
    """Headings of object, group and bin; columns with empty headings are left out."""
    page: tuple[str, ...] = ()
    """Patterns of the groups that the figures page shows; the results show all."""
    part: str = ""
    """Part of the results with the rows; empty: the part with the table's name."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "part", self.part or self.name)

    def figures(self, frames: pd.DataFrame) -> Iterator[dict[str, Any]]:
        """Yield a row for each group, object and bin: `table`, `group`, `object`, `bin`, `n`, all metrics."""
        for (group, name), own in frames.groupby(["group", "object"], sort=False):
            if not matches(group, self.groups) or matches(group, self.without):
                continue
            for label, rows in self.split(own) if self.split else [("", own)]:
                about = {"table": self.name, "group": group, "object": name, "bin": label, "n": len(rows)}
                yield about | {metric.name: metric.of(rows) for metric in self.metrics}


def matches(group: str, patterns: Iterable[str]) -> bool:
    """Return whether a group's name matches one of the patterns, in which * is a wildcard."""
    return any(fnmatchcase(group, pattern) for pattern in patterns)


def by_visibility(*borders: tuple[float, float]) -> Split:
    """Return a split into the non-empty bins of the visible fraction.

    A bin includes its lower end, and its upper end only if that is 1.
    """

    def split(rows: Rows) -> Iterator[tuple[str, Rows]]:
        for low, high in borders:
            own = rows[(rows.visible >= low) & ((rows.visible < high) | (high == 1.0))]
            if len(own):
                yield f"{low:g}-{high:g}", own

    return split


def at(column: str, q: float) -> Callable[[Rows], float]:
    """Return a function for a quantile of a column's finite values."""
    return lambda rows: quantile(rows[column], q)


def value(column: str) -> Callable[[Rows], float]:
    """Return a function for the mean of a column; for a single row it is the value."""
    return lambda rows: mean(rows[column].to_numpy(float)) if column in rows else math.nan


def typical(column: str) -> Callable[[Rows], float]:
    """Return a function for the geometric mean of a column, which no single large value dominates."""
    return lambda rows: math.exp(mean(np.log(np.maximum(rows[column].dropna(), 1e-9))))


def share(
    name: str,
    title: str,
    flags: Callable[[Rows], Array],
    better: str = "lower",
    *,
    form: str = "{:.1f} %",
    step: float | None = None,
    given: bool = False,
) -> Metric:
    """Return a metric for the share of rows that meet a condition [%]; `given`: of those with a pose."""

    def of(rows: Rows) -> float:
        return percent(np.asarray(flags(rows[rows.found] if given else rows), bool))

    return Metric(name, title, of, form, better, step=step, share=True, given=given)


def right(rows: Rows, prefix: str = "", millimetres: float = 5.0) -> Array:
    """Return (N,) whether poses are within `millimetres` and 5° of the truth; False for nan."""
    errors = rows[[f"{prefix}mm", f"{prefix}deg"]].to_numpy(np.float64)
    return np.asarray((errors <= (millimetres, 5.0)).all(axis=1))


def sure(rows: Rows) -> Array:
    """Return (N,) whether the confidence is above one half."""
    return np.asarray(rows.confidence.fillna(0).to_numpy(float) > SURE)


def _brier(rows: Rows) -> float:
    given = rows[rows.found]
    return mean((given.confidence - right(given)) ** 2)


def _dishonesty(rows: Rows) -> float:
    """Return the absolute difference between mean confidence and share of right poses [percentage points]."""
    given = rows[rows.found]
    return abs(100 * mean(given.confidence) - percent(right(given))) if len(given) else math.nan


MEDIAN = Metric("median_mm", "position, median", at("mm", 0.5), "{:.3f} mm")
P90 = Metric("p90_mm", "90th percentile", at("mm", 0.9), "{:.2f} mm", factor=1.1, below=0.9)
RIGHT = share("within_5", "within 5 mm and 5°", right, "higher", step=0.7)
WRONG_AND_SURE = share("wrong_and_sure", "wrong and sure", lambda rows: sure(rows) & ~right(rows), step=0.3)
INSIDE = share(
    "inside_95",
    "inside the 95 % ellipsoid",
    lambda rows: rows.nees <= ELLIPSOID_95,
    "higher",
    form="{:.0f} %",
    step=3.0,
    given=True,
)
MEDIAN_DEG = Metric("median_deg", "rotation, median", at("deg", 0.5), "{:.2f}°")
NEES = Metric("median_nees", "NEES, median", at("nees", 0.5), "{:.1f}", "same")
HONESTY = Metric("honesty", "stated − right", _dishonesty, "{:.1f} points", step=1.0)

ANSWERS = (
    MEDIAN,
    P90,
    Metric("p99_mm", "99th", at("mm", 0.99), "{:.2f} mm", below=0.99),
    MEDIAN_DEG,
    Metric("p90_deg", "90th percentile", at("deg", 0.9), "{:.2f}°", factor=1.1, below=0.9),
    Metric("median_roll_deg", "roll, median", at("roll_deg", 0.5), "{:.2f}°"),
    RIGHT,
    share("none", "no pose", lambda rows: ~rows.found),
    WRONG_AND_SURE,
)
"""Errors of the poses found, and shares of all answers."""

TRUST = (
    NEES,
    INSIDE,
    Metric("confidence", "mean confidence", lambda rows: 100 * mean(rows.confidence.dropna()), "{:.1f} %"),
    HONESTY,
    Metric("brier", "Brier score", _brier, "{:.4f}", step=0.003),
)
"""Whether covariance and confidence are right."""

TIMES = (
    Metric("median_ms", "time, median", at("ms", 0.5), "{:.1f} ms"),
    Metric("p99_ms", "99th percentile", at("ms", 0.99), "{:.1f} ms", below=0.99),
    Metric("ratio", "× reference", at("ratio", 0.5), "{:.2f}", factor=SLOWER),
    Metric("p99_ratio", "99th percentile", at("ratio", 0.99), "{:.1f}", factor=SLOWER, below=0.99),
)
"""Time of an answer [ms], and as a multiple of the reference work on the same images."""

FINDS = (
    share("found", "given a pose", lambda rows: rows.found),
    share("above_5", "above 0.5", sure, step=4.0),
    share("above_9", "above 0.9", lambda rows: rows.confidence > 0.9),
    Metric("greatest", "greatest confidence", lambda rows: quantile(rows.confidence, 1.0), "{:.3f}"),
)
"""Figures for images that do not show the object."""

TYPICAL = (
    Metric("typical_mm", "position, typical", typical("mm"), "{:.3f} mm", factor=1.03),
    Metric("typical_deg", "rotation, typical", typical("deg"), "{:.3f}°", factor=1.03),
    Metric("typical_nees", "NEES, typical", typical("nees"), "{:.2f}", "same", factor=1.15),
)
"""Figures for the gate, sensitive to any change in its few scenes."""

PAIRED = (
    share(
        "grown", "errors grown by more than 1 mm", lambda rows: rows.mm_after > rows.mm_before + 1.0, step=1.5
    ),
    Metric(
        "moved",
        "confidence changed by, on average",
        lambda rows: mean((rows.confidence_after - rows.confidence_before).abs().dropna()),
        "{:.4f}",
        step=0.001,
    ),
)
"""Figures of pairs of answers to the same images, whose columns end in `_before` and `_after`."""
