"""Figures, each declared once: name, function, format, which way is better, what the gate allows.

A metric is made of the rows of a data frame: what the tracker answered, a row an answer.
`benchmarks.score.tables` says which rows.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Any, TypeAlias

import numpy as np
import pandas as pd
from scipy.stats import chi2

from benchmarks.score.shares import (
    RIGHT_MM,
    SURE,
    bootstrap_interval,
    mean,
    percent,
    quantile,
    wilson_interval,
    within,
)
from tracker.conventions import Array

Rows: TypeAlias = pd.DataFrame

Split = Callable[[Rows], Iterable[tuple[str, Rows]]]
"""Bins of rows, by name."""

NOTHING = "–"
"""Stands for what was not measured."""

ELLIPSOID_95 = float(chi2.ppf(0.95, 6))
"""Greatest NEES inside the stated 95 % ellipsoid."""


@dataclass(frozen=True)
class Metric:
    """One figure of some rows."""

    name: str
    """In results."""
    title: str
    """Heading of its column."""
    of: Callable[[Rows], float]
    """The figure; nan where there is nothing to be measured."""
    form: str = "{:.3g}"
    """How it is written, with its unit."""
    better: str = "lower"
    """`lower`, `higher`, or `same`: the gate lets it change neither way."""
    factor: float | None = None
    """By which it may become worse in the gate; None: not held as a factor."""
    step: float | None = None
    """The same as a difference."""
    share: bool = False
    """Whether it is a share of the rows [%], whose interval is Wilson's."""

    def text(self, value: float | None) -> str:
        """The figure as it is written."""
        return NOTHING if value is None or not math.isfinite(value) else self.form.format(value)

    def interval(self, rows: Rows) -> tuple[float, float]:
        """In which the figure lies with 95 % confidence."""
        if self.share:
            return wilson_interval(self.of(rows), len(rows))
        return bootstrap_interval(self.of, rows)

    def worse(self, before: float, after: float) -> bool:
        """Whether the figure fell by more than the gate allows; one that was measured must still be there."""
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
    """Figures of the rows of one part, for each group, object and bin."""

    name: str
    """In results."""
    part: str
    """Whose rows they are."""
    title: str
    text: str
    """What it shows, above it."""
    metrics: tuple[Metric, ...]
    groups: tuple[str, ...] = ("*",)
    """Patterns of the groups that it shows."""
    without: tuple[str, ...] = ()
    """Patterns of those that it leaves out."""
    split: Split | None = None
    """Into bins; None: there are none."""
    heads: tuple[str, str, str] = ("object", "", "")
    """Headings of object, group and bin; what is empty is left out."""
    page: tuple[str, ...] = ()
    """Patterns of the groups that the page of figures shows; the results show all."""

    def figures(self, frames: pd.DataFrame) -> Iterator[dict[str, Any]]:
        """A row for each group, object and bin: `table`, `group`, `object`, `bin`, `n`, and each metric."""
        for (group, name), own in frames.groupby(["group", "object"], sort=False):
            if not matches(group, self.groups) or matches(group, self.without):
                continue
            for label, rows in self.split(own) if self.split else [("", own)]:
                about = {"table": self.name, "group": group, "object": name, "bin": label, "n": len(rows)}
                yield about | {metric.name: metric.of(rows) for metric in self.metrics}


def matches(group: str, patterns: Iterable[str]) -> bool:
    """Whether a group's name is one of the patterns, in which * stands for anything."""
    return any(fnmatchcase(group, pattern) for pattern in patterns)


def by_visibility(*borders: tuple[float, float]) -> Split:
    """Bins of the visible fraction that hold any.

    The lower end belongs to a bin, the upper only where it is 1.
    """

    def split(rows: Rows) -> Iterator[tuple[str, Rows]]:
        for low, high in borders:
            own = rows[(rows.visible >= low) & ((rows.visible < high) | (high == 1.0))]
            if len(own):
                yield f"{low:g}-{high:g}", own

    return split


def at(column: str, q: float) -> Callable[[Rows], float]:
    """A quantile of the finite values of a column."""
    return lambda rows: quantile(rows[column], q)


def value(column: str) -> Callable[[Rows], float]:
    """The mean of a column; of a single row its value."""
    return lambda rows: mean(rows[column].to_numpy(float)) if column in rows else math.nan


def typical(column: str) -> Callable[[Rows], float]:
    """The geometric mean of a column: every row counts, and none by its size."""
    return lambda rows: math.exp(mean(np.log(np.maximum(rows[column].dropna(), 1e-9))))


def share(flags: Callable[[Rows], Array]) -> Callable[[Rows], float]:
    """Of rows for which a condition holds [%]."""
    return lambda rows: percent(np.asarray(flags(rows), bool))


def right(rows: Rows, prefix: str = "", millimetres: float = RIGHT_MM) -> Array:
    """(N,) whether poses are within so many millimetres and 5° of the truth."""
    return within(rows[[f"{prefix}mm", f"{prefix}deg"]].to_numpy(), millimetres)


def sure(rows: Rows) -> Array:
    """(N,) whether the confidence is above one half."""
    return np.asarray(rows.confidence.fillna(0).to_numpy(float) > SURE)


def _brier(rows: Rows) -> float:
    given = rows[rows.found]
    return mean((given.confidence - right(given)) ** 2)


def _dishonesty(rows: Rows) -> float:
    """Mean confidence against the share of poses that are right, in points."""
    given = rows[rows.found]
    return abs(100 * mean(given.confidence) - percent(right(given))) if len(given) else math.nan


MEDIAN = Metric("median_mm", "position, median", at("mm", 0.5), "{:.3f} mm")
P90 = Metric("p90_mm", "90th percentile", at("mm", 0.9), "{:.2f} mm", factor=1.1)
RIGHT = Metric("within_5", "within 5 mm and 5°", share(right), "{:.1f} %", "higher", step=0.7, share=True)
WRONG_AND_SURE = Metric(
    "wrong_and_sure",
    "wrong and sure",
    share(lambda rows: sure(rows) & ~right(rows)),
    "{:.1f} %",
    step=0.3,
    share=True,
)
INSIDE = Metric(
    "inside_95",
    "inside the 95 % ellipsoid",
    lambda rows: percent(rows.nees[rows.found] <= ELLIPSOID_95),
    "{:.0f} %",
    "higher",
    step=3.0,
)
MEDIAN_DEG = Metric("median_deg", "rotation, median", at("deg", 0.5), "{:.2f}°")
NEES = Metric("median_nees", "NEES, median", at("nees", 0.5), "{:.1f}", "same")
HONESTY = Metric("honesty", "stated − right", _dishonesty, "{:.1f} points", step=1.0)

ANSWERS = (
    MEDIAN,
    P90,
    Metric("p99_mm", "99th", at("mm", 0.99), "{:.2f} mm"),
    MEDIAN_DEG,
    Metric("p90_deg", "90th percentile", at("deg", 0.9), "{:.2f}°", factor=1.1),
    Metric("median_roll_deg", "roll, median", at("roll_deg", 0.5), "{:.2f}°"),
    RIGHT,
    Metric("none", "no pose", share(lambda rows: ~rows.found), "{:.1f} %", share=True),
    WRONG_AND_SURE,
)
"""How far the poses given are from the truth, and shares of all answers."""

TRUST = (
    NEES,
    INSIDE,
    Metric("confidence", "mean confidence", lambda rows: 100 * mean(rows.confidence.dropna()), "{:.1f} %"),
    HONESTY,
    Metric("brier", "Brier score", _brier, "{:.4f}", step=0.003),
)
"""Whether covariance and confidence are true."""

TIMES = (
    Metric("median_ms", "time, median", at("ms", 0.5), "{:.1f} ms"),
    Metric("p99_ms", "99th percentile", at("ms", 0.99), "{:.1f} ms"),
    Metric("ratio", "× reference", at("ratio", 0.5), "{:.2f}", factor=1.2),
    Metric("p99_ratio", "99th percentile", at("ratio", 0.99), "{:.1f}", factor=1.35),
)
"""What an answer costs, in milliseconds and as a multiple of the reference work on the same pictures."""

FINDS = (
    Metric("found", "given a pose", share(lambda rows: rows.found), "{:.1f} %", share=True),
    Metric("above_5", "above 0.5", share(sure), "{:.1f} %", step=4.0, share=True),
    Metric("above_9", "above 0.9", share(lambda rows: rows.confidence > 0.9), "{:.1f} %", share=True),
    Metric("greatest", "greatest confidence", lambda rows: quantile(rows.confidence, 1.0), "{:.3f}"),
)
"""Of pictures that do not show the object."""

TYPICAL = (
    Metric("typical_mm", "position, typical", typical("mm"), "{:.3f} mm", factor=1.03),
    Metric("typical_deg", "rotation, typical", typical("deg"), "{:.3f}°", factor=1.03),
    Metric("typical_nees", "NEES, typical", typical("nees"), "{:.2f}", "same", factor=1.15),
)
"""Of the gate: a few scenes that everything of them changes."""

PAIRED = (
    Metric(
        "grown",
        "errors grown by more than 1 mm",
        share(lambda rows: rows.mm_after > rows.mm_before + 1.0),
        "{:.1f} %",
        step=1.5,
    ),
    Metric(
        "moved",
        "confidence changed by, on average",
        lambda rows: mean((rows.confidence_after - rows.confidence_before).abs().dropna()),
        "{:.4f}",
        step=0.001,
    ),
)
"""Of pairs of answers to the same pictures, whose columns end in `_before` and `_after`."""
