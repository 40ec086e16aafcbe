"""Plots of errors: against what is visible, against the bound, and how they are distributed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.report import theme
from tracker.conventions import Array, FloatArray

Quantity = tuple[str, str, str]
"""Name, unit, and the end of the field's name in the records."""

QUANTITIES: tuple[Quantity, ...] = (("position", "mm", "position_mm"), ("rotation", "°", "rotation_deg"))
_BOUNDS = {"position_mm": "bound_mm", "rotation_deg": "bound_deg"}
RATIOS = ((1.0, "1"), (1.5, "1.5"), (3.0, "3"))
"""Lines in the plots against the bound."""


def objects_of(frames: pd.DataFrame) -> list[str]:
    """Names of the objects, in order of appearance."""
    return list(dict.fromkeys(frames.object))


def against_visible_fraction(frames: pd.DataFrame) -> str:
    """Error against visible fraction, with a running median; frames without a pose along the top."""
    names = objects_of(frames)

    def draw(figure: Figure) -> None:
        panels = figure.subplots(2, len(names), sharex=True, sharey="row", squeeze=False)
        for row, (quantity, unit, key) in zip(panels, QUANTITIES, strict=True):
            for axes, name in zip(row, names, strict=True):
                own = frames[(frames.object == name) & frames.present]
                _cloud_by_fraction(axes, own, key, theme.SERIES[names.index(name)])
            row[0].set_ylabel(f"{quantity} error [{unit}]")
        for axes, name in zip(panels[0], names, strict=True):
            axes.set_title(name)
        for axes in panels[-1]:
            axes.set_xlabel("visible fraction of the object, mean over the cameras")
        for axes in panels.flat:
            theme.plain_ticks(axes, "y")
        theme.legend_above(figure, *panels.flat)

    return theme.svg("visible", "Error against visible fraction, one point a frame", (10.4, 6.4), draw)


def _cloud_by_fraction(axes: Axes, frames: pd.DataFrame, key: str, color: str) -> None:
    fraction, error = frames.visible_fraction.to_numpy(), frames[key].to_numpy()
    found = np.isfinite(error)
    axes.set_yscale("log")
    axes.plot(fraction[found], error[found], ".", color=color, alpha=0.6, ms=5, mew=0, label="a frame")
    centers, medians = running_median(fraction[found], error[found])
    axes.plot(centers, medians, color=theme.INK, label="running median")
    if (~found).any():
        # In axes coordinates: they have no error.
        axes.plot(
            fraction[~found],
            np.full(np.count_nonzero(~found), 0.98),
            "x",
            color=theme.FOURTH,
            ms=6,
            mew=1.6,
            transform=axes.get_xaxis_transform(),
            clip_on=False,
            label="no pose",
        )


def running_median(at: Array, values: Array, share: float = 0.12) -> tuple[FloatArray, FloatArray]:
    """Medians over windows of `share` of the points in the order of `at`; NaN-free input (N,)."""
    order = np.argsort(at, kind="stable")
    at, values = at[order], values[order]
    width = max(3, round(share * len(at)))
    if len(at) < width:
        return np.array([]), np.array([])
    windows = np.lib.stride_tricks.sliding_window_view
    return np.median(windows(at, width), axis=1), np.median(windows(values, width), axis=1)


def against_bound(frames: pd.DataFrame, workloads: Sequence[str]) -> str:
    """Error against the Cramér-Rao bound of the same frame, for both quantities and objects."""
    chosen = frames[frames.workload.isin(workloads) & frames.found & frames.present]
    names = objects_of(chosen)

    def draw(figure: Figure) -> None:
        panels = figure.subplots(2, len(names), sharex="row", sharey="row", squeeze=False)
        for row, (quantity, unit, key) in zip(panels, QUANTITIES, strict=True):
            for axes, name in zip(row, names, strict=True):
                axes.set_xscale("log")
                axes.set_yscale("log")
                for number, workload in enumerate(workloads):
                    own = chosen[(chosen.object == name) & (chosen.workload == workload)]
                    bound, error = own[_BOUNDS[key]], own[key]
                    color = (theme.FIFTH, theme.THIRD)[number % 2]
                    axes.plot(bound, error, ".", color=color, alpha=0.65, ms=5, mew=0, label=workload)
                axes.set_xlabel(f"bound [{unit}]")
            row[0].set_ylabel(f"{quantity} error [{unit}]")
            _ratio_lines(row)
        for axes, name in zip(panels[0], names, strict=True):
            axes.set_title(name)
        theme.legend_above(figure, *panels.flat)

    return theme.svg("bound", "Error against the Cramér-Rao bound, one point a frame", (10.4, 8.0), draw)


def _ratio_lines(row: Sequence[Axes]) -> None:
    low, high = row[0].get_xlim()
    ends = np.array([low, high])
    for axes in row:
        for ratio, label in RATIOS:
            style = "-" if ratio == 1.0 else (0, (5, 3)) if ratio < 2 else (0, (1.5, 2))
            axes.plot(ends, ratio * ends, color=theme.INK, lw=1.1, ls=style)
            axes.annotate(
                f"×{label}",
                (high, ratio * high),
                xytext=(3, 0),
                textcoords="offset points",
                va="center",
                fontsize=9,
                annotation_clip=False,
            )
        axes.set_xlim(low, high)
        theme.plain_ticks(axes, "x")
        theme.plain_ticks(axes, "y")


def cumulative(frames: pd.DataFrame, workload: str) -> str:
    """Share of frames whose error is at most so large, and that of their bound."""
    chosen = frames[(frames.workload == workload) & frames.present]
    names = objects_of(chosen)

    def draw(figure: Figure) -> None:
        panels = figure.subplots(len(QUANTITIES), len(names), sharex="row", sharey=True, squeeze=False)
        for row, (quantity, unit, key) in zip(panels, QUANTITIES, strict=True):
            for axes, name in zip(row, names, strict=True):
                own = chosen[chosen.object == name]
                _curve(axes, own[key].to_numpy(), theme.INK, "tracker")
                bounded = own[_BOUNDS[key]].dropna()
                if len(bounded):
                    _curve(axes, bounded.to_numpy(), theme.FAINT, "bound", ls=(0, (2, 2)))
                axes.set_xscale("log")
                axes.set_xlabel(f"{quantity} error [{unit}]")
                axes.set_ylim(0, 102)
                axes.set_title(f"{name}: {len(own)} frames" if key == "position_mm" else "")
            row[0].set_ylabel("frames [%]")
            for axes in row:
                theme.plain_ticks(axes, "x")
        theme.legend_above(figure, *panels.flat)

    return theme.svg("cumulative", "Cumulative errors and their bound", (10.4, 6.4), draw)


def _curve(axes: Axes, errors: Array, color: str, label: str, ls: object = "-") -> None:
    found = np.sort(errors[np.isfinite(errors)])
    if len(found):
        share = 100 * np.arange(1, len(found) + 1) / len(errors)
        axes.step(found, share, where="post", color=color, label=label, ls=ls)
