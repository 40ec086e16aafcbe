"""Plots of how far the tracker's own statements can be trusted: its confidence and its covariance."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.stats import chi2

from benchmarks.report import theme
from benchmarks.report.accuracy_plots import objects_of
from benchmarks.score.shares import interval, within
from benchmarks.score.summary import FREEDOM
from tracker.conventions import Array, FloatArray

EDGES = (0.0, 0.2, 0.4, 0.6, 0.8, 0.9, 0.97, 1.0)
"""Of the bins of confidence: finer where most answers are."""

NEES_END = 30.0
"""What is beyond goes into the last bin."""


def reliability(given: pd.DataFrame) -> str:
    """Share of right answers by stated confidence, and how many answers stated it."""
    names = objects_of(given)

    def draw(figure: Figure) -> None:
        panels = figure.subplots(
            2, len(names), sharex=True, sharey="row", squeeze=False, gridspec_kw={"height_ratios": [3, 1]}
        )
        for column_of, name in enumerate(names):
            own = given[given.object == name]
            color = theme.SERIES[column_of]
            _shares(panels[0, column_of], panels[1, column_of], own, color)
            panels[0, column_of].set_title(name)
            panels[1, column_of].set_xlabel("stated confidence")
        panels[0, 0].set_ylabel("within 5 mm and 5°")
        panels[1, 0].set_ylabel("answers")
        panels[0, 0].legend(loc="lower right")

    return theme.svg("reliability", "Share of right answers against stated confidence", (10.4, 5.6), draw)


def _shares(above: Axes, below: Axes, frames: pd.DataFrame, color: str) -> None:
    confidence = frames.confidence.to_numpy()
    hits = within(frames[["position_mm", "rotation_deg"]].to_numpy())
    bins = np.clip(np.digitize(confidence, EDGES) - 1, 0, len(EDGES) - 2)
    counts = np.bincount(bins, minlength=len(EDGES) - 1)
    above.plot([0, 1], [0, 1], color=theme.FAINT, lw=1.1, ls=(0, (4, 3)), label="ideal")
    points: list[tuple[float, float, float, float]] = []
    for number in np.flatnonzero(counts):
        chosen = bins == number
        share = float(hits[chosen].mean())
        low, high = interval(100 * share, int(counts[number]))
        points.append((float(confidence[chosen].mean()), share, low / 100, high / 100))
    at, shares, low_ends, high_ends = np.array(points).T
    errors: FloatArray = np.maximum(np.stack([shares - low_ends, high_ends - shares]), 0.0)
    above.errorbar(
        at, shares, yerr=errors, color=color, fmt="o-", ms=5, lw=1.6, elinewidth=1.2, label="measured"
    )
    above.set_xlim(-0.02, 1.02)
    above.set_ylim(-0.03, 1.06)
    widths = np.diff(EDGES)
    below.bar(EDGES[:-1], counts, widths, align="edge", color=color, alpha=0.75, ec=theme.PAPER, lw=1)
    below.set_yscale("log")
    below.set_ylim(0.7, 40 * max(2, counts.max()))
    theme.plain_ticks(below, "y")
    for left, width, count in zip(EDGES, widths, counts, strict=False):
        if count:
            # A narrow bar has room for digits one above the other only.
            turned = width < 0.08
            below.annotate(
                f"{count}",
                (left + width / 2, count),
                xytext=(0, 2),
                textcoords="offset points",
                ha="center",
                va="bottom",
                rotation=90 if turned else 0,
                fontsize=8.5,
            )


def nees(frames: pd.DataFrame, workloads: Sequence[str]) -> str:
    """Normalised errors squared next to the chi-square density of six degrees of freedom."""
    chosen = frames[frames.workload.isin(workloads) & frames.nees.notna()]
    names = objects_of(chosen)
    edges = np.linspace(0, NEES_END, 31)

    def draw(figure: Figure) -> None:
        panels = figure.subplots(len(workloads), len(names), sharex=True, sharey=True, squeeze=False)
        for row, workload in zip(panels, workloads, strict=True):
            for axes, name in zip(row, names, strict=True):
                values = chosen.nees[(chosen.object == name) & (chosen.workload == workload)].to_numpy()
                color = theme.SERIES[names.index(name)]
                _histogram(axes, values, edges, color)
                middle = f": median {np.median(values):.1f}, n = {len(values)}" if len(values) else ""
                axes.set_title(f"{name}, {workload}{middle}", fontsize=10)
            row[0].set_ylabel("density")
        for axes in panels[-1]:
            axes.set_xlabel(f"normalised error squared (all above {NEES_END:g} in the last bar)")
        theme.legend_above(figure, *panels.flat)

    return theme.svg(
        "nees", "Histogram of normalised errors squared", (10.4, 0.6 + 2.6 * len(workloads)), draw
    )


def _histogram(axes: Axes, values: Array, edges: FloatArray, color: str) -> None:
    if len(values):
        weights = np.full(len(values), 1 / (len(values) * (edges[1] - edges[0])))
        axes.hist(
            np.minimum(values, NEES_END - 1e-9), edges.tolist(), weights=weights, color=color, alpha=0.7
        )
        axes.axvline(float(np.median(values)), color=color, lw=1.8, ls=(0, (4, 2)))
    at = np.linspace(0, NEES_END, 200)
    axes.plot(
        at, chi2.pdf(at, FREEDOM), color=theme.INK, lw=1.5, label="χ² of 6 degrees of freedom, median 5.35"
    )
    axes.set_xlim(0, NEES_END)
