"""Plots of time: by stage, and over cameras, resolution and faces in view."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from benchmarks.report import theme

Row = dict[str, Any]

PARTS = ("time", "time, stages", "time, cameras", "time, resolution", "time, faces")
"""Of the results, that are drawn."""


def stages(stage_rows: Sequence[Row], detect_rows: Sequence[Row]) -> str:
    """A bar for each set of pictures, stacked of the stages' medians; beside it the whole's multiple."""
    keys = [_key(row) for row in detect_rows]
    names = list(dict.fromkeys(row["bin"] for row in stage_rows))
    time_of = {(_key(row), row["bin"]): row["median_ms"] for row in stage_rows}

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        places = np.arange(len(keys))[::-1]
        left = np.zeros(len(keys))
        for number, name in enumerate(names):
            widths = np.array([time_of.get((key, name), 0.0) for key in keys])
            color, opacity = _paint(number)
            axes.barh(
                places, widths, 0.62, left=left, label=name, color=color, alpha=opacity, ec=theme.PAPER, lw=1
            )
            left += widths
        for place, end, row in zip(places, left, detect_rows, strict=True):
            text = f"{row['median_ms']:.1f} ms = {row['ratio']:.2f} × reference"
            axes.annotate(
                text, (end, place), xytext=(7, 0), textcoords="offset points", va="center", fontsize=9.5
            )
        axes.set_yticks(places, ["\n".join(key) for key in keys])
        axes.set_xlim(0, 1.38 * max(left, default=1.0))
        axes.set_ylim(-0.6, len(keys) - 0.4)
        axes.grid(visible=False, axis="y")
        axes.set_xlabel("time, median of each stage [ms]")
        axes.legend(loc="lower left", bbox_to_anchor=(0, 1.0), ncols=min(len(names), 6), borderaxespad=0.3)

    return theme.svg("stages", "Time of each stage, stacked", (10.4, 1.3 + 0.62 * len(keys)), draw)


def _key(row: Row) -> tuple[str, str]:
    return str(row["object"]), str(row["group"])


def _paint(number: int) -> tuple[str, float]:
    """Beyond the palette's end its colours come again, paler."""
    rounds, place = divmod(number, len(theme.SERIES))
    return theme.SERIES[place], max(0.35, 0.92 - 0.35 * rounds)


def scaling(cameras: Sequence[Row], resolution: Sequence[Row], faces: Sequence[Row]) -> str:
    """Median time, and p99 as a thin line, over number of cameras, height of the pictures, faces in view."""

    def draw(figure: Figure) -> None:
        by_cameras, by_size, by_faces = figure.subplots(1, 3)
        _lines(by_cameras, cameras, width=0.04)
        by_cameras.set_xlabel("cameras")
        by_cameras.set_title("number of cameras")
        _lines(by_size, resolution, width=0.0)
        reference = {int(row["bin"]): row["reference_ms"] for row in resolution}
        by_size.plot(
            list(reference),
            list(reference.values()),
            color=theme.FAINT,
            ls=(0, (3, 2)),
            label="reference work",
        )
        by_size.set_xscale("log")
        by_size.set_yscale("log")
        sizes = sorted(reference)
        by_size.set_xticks(sizes, [str(size) for size in sizes])
        by_size.xaxis.set_minor_locator(NullLocator())
        theme.plain_ticks(by_size, "y")
        by_size.set_xlabel("height of the pictures [px]")
        by_size.set_title("resolution")
        _lines(by_faces, faces, width=0.1)
        by_faces.set_xlabel("faces in view, summed over cameras")
        by_faces.set_title("faces in view")
        for axes in (by_cameras, by_faces):
            axes.set_ylim(bottom=0)
        for axes, rows in ((by_cameras, cameras), (by_faces, faces)):
            axes.set_xticks(sorted({int(row["bin"]) for row in rows}))
        by_cameras.set_ylabel("a detection [ms]")
        theme.legend_above(figure, by_size)

    return theme.svg("scaling", "Time over cameras, resolution and faces in view", (10.4, 4.0), draw)


def _lines(axes: Axes, rows: Sequence[Row], width: float) -> None:
    names = list(dict.fromkeys(row["object"] for row in rows))
    for number, name in enumerate(names):
        own = sorted((row for row in rows if row["object"] == name), key=lambda row: int(row["bin"]))
        # Side by side, so that the p99 of one object does not hide the other's.
        at = np.array([float(row["bin"]) for row in own]) + width * (2 * number - len(names) + 1)
        median = np.array([row["median_ms"] for row in own])
        p99 = np.array([row["p99_ms"] for row in own])
        color = theme.SERIES[number]
        axes.plot(at, median, "o-", color=color, ms=5, label=name)
        axes.vlines(at, median, np.maximum(p99, median), color=color, lw=1.1, alpha=0.8)
        axes.plot(at, p99, "_", color=color, ms=8)
