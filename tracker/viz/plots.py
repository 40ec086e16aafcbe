"""The look of plots over time: dark like the other pictures, one panel below the other."""

from __future__ import annotations

from itertools import groupby
from typing import Any, Literal, NamedTuple

import numpy as np

from tracker.conventions import Array, FloatArray
from tracker.viz import paint
from tracker.viz.footer import DOUBTFUL, GOOD

STATUS_COLORS: dict[str, paint.Color] = {
    "found": GOOD,
    "tracking": GOOD,
    "refound": (225, 200, 90),
    "coasting": DOUBTFUL,
    "lost": (95, 85, 225),
}
"""Colours of a status strip; other statuses have those of _REASONS."""

_REASONS: tuple[paint.Color, ...] = ((180, 110, 150), (185, 140, 90), (170, 150, 200), (105, 98, 92))
_GRID: paint.Color = (58, 51, 47)
_LABEL_X = -0.065  # left of the longest tick label, so that the labels of all panels are aligned
_LEAST_SHARE = 0.003
"""Share of the strip's width that the shortest run has, so that single frames are seen."""
_FEW = 250
"""Frames up to which dots are drawn in full size."""


class Series(NamedTuple):
    """What one panel shows of n frames; NaN where there is nothing."""

    label: str
    color: paint.Color
    line: FloatArray
    low: FloatArray
    """Lower end of the band around the line."""
    high: FloatArray
    """Upper end."""
    dots: FloatArray
    circles: FloatArray
    circle_color: paint.Color
    limits: tuple[float, float] | None = None
    """Of the axis; None: fitted to the values, and not to the band, which can reach very far."""
    least: float = 2.0
    """Least height of an axis that is fitted."""


def draw_panel(axis: Any, time: Array, series: Series) -> None:
    """Draw a line with a band, dots and circles over time."""
    color = rgb(series.color)
    size = float(np.clip(np.sqrt(_FEW / max(len(time), 1)), 0.5, 1))
    values = np.concatenate([series.line, series.dots, series.circles])
    bottom, top = _limits(series, values[np.isfinite(values)])
    if np.isfinite(series.low).any():
        # A variance may have any size, a pixel's place may not.
        far = 10 * (top - bottom)
        low, high = (np.clip(end, bottom - far, top + far) for end in (series.low, series.high))
        axis.fill_between(time, low, high, color=color, alpha=0.3, linewidth=0)
    axis.plot(
        time,
        series.circles,
        "o",
        markersize=3.8 * size,
        markeredgewidth=0.9 * size,
        fillstyle="none",
        color=rgb(series.circle_color),
        alpha=0.8,
    )
    axis.plot(time, series.line, "-", linewidth=1.3, color=color)
    axis.plot(time, series.dots, ".", markersize=4.4 * size, color=color)
    axis.set_ylabel(series.label, color=color, fontsize=11)
    axis.yaxis.set_label_coords(_LABEL_X, 0.5)
    axis.set_ylim(bottom, top)
    if not np.isfinite(values).any():
        axis.set_yticks([])
        axis.text(
            0.5, 0.5, "no pose", color=rgb(paint.FAINT), fontsize=10, ha="center", transform=axis.transAxes
        )


def _limits(series: Series, values: FloatArray) -> tuple[float, float]:
    """Lower and upper end of a panel that shows finite values (k,)."""
    if series.limits is not None:
        return series.limits
    low, high = (float(values.min()), float(values.max())) if values.size else (0.0, 0.0)
    room = max(0.08 * (high - low), (series.least - (high - low)) / 2)
    return low - room, high + room


def draw_status(axis: Any, time: Array, status: Array) -> None:
    """Draw a strip in the colour of each frame's status, with a legend above."""
    axis.set(yticks=[], ylim=(0, 1))
    axis.grid(False)
    axis.spines[:].set_visible(False)
    axis.set_ylabel("status", color=rgb(paint.FAINT), fontsize=11, rotation=0, ha="center", va="center")
    axis.yaxis.set_label_coords(_LABEL_X, 0.5)
    if not len(time):
        return
    last = time[-1] + (np.median(np.diff(time)) if len(time) > 1 else 0.1)
    ends = np.append(time[1:], last)
    colors = _status_colors(status)
    least = _LEAST_SHARE * (last - time[0])
    runs = []
    row = 0
    for name, frames in groupby(status.tolist()):
        start, row = row, row + len(list(frames))
        runs.append((max(ends[row - 1] - time[start], least), time[start], name))
    for width, start_time, name in sorted(runs, reverse=True):  # short ones on top of long ones
        axis.axvspan(start_time, start_time + width, color=rgb(colors[name]), linewidth=0)
    draw_legend(axis, [patch(color, name) for name, color in colors.items()], (0, 1.1), "lower left")


def _status_colors(status: Array) -> dict[str, paint.Color]:
    """A colour for each status that occurs, the well-known ones first."""
    names = sorted(set(status.tolist()))
    reasons = [name for name in names if name not in STATUS_COLORS]
    known = {name: color for name, color in STATUS_COLORS.items() if name in names}
    return known | {name: _REASONS[number % len(_REASONS)] for number, name in enumerate(reasons)}


def draw_legend(axis: Any, handles: list[Any], at: tuple[float, float], corner: str) -> None:
    """Write a legend in one line whose `corner` is at a place in units of the panel."""
    axis.legend(
        handles=handles,
        loc=corner,
        bbox_to_anchor=at,
        ncols=max(1, len(handles)),
        frameon=False,
        fontsize=9,
        labelcolor=rgb(paint.FAINT),
        borderaxespad=0,
        borderpad=0,
        handlelength=1.4,
        columnspacing=1.6,
    )


def patch(color: paint.Color, label: str, opacity: float = 1.0) -> Any:
    """A legend's area."""
    from matplotlib.patches import Patch

    return Patch(color=rgb(color), alpha=opacity, linewidth=0, label=label)


def mark(color: paint.Color, label: str, marker: Literal["-", ".", "o"]) -> Any:
    """A legend's line, dot or circle."""
    from matplotlib.lines import Line2D

    if marker == "-":
        return Line2D([], [], color=rgb(color), label=label)
    fill: Literal["none", "full"] = "none" if marker == "o" else "full"
    return Line2D(
        [], [], color=rgb(color), linestyle="", marker=marker, markersize=4, fillstyle=fill, label=label
    )


def style(axis: Any) -> None:
    """Dark, with a faint grid and few lines."""
    axis.set_facecolor(rgb(paint.BACKGROUND))
    axis.grid(color=rgb(_GRID), linewidth=0.8)
    axis.set_axisbelow(True)
    axis.spines[["top", "right", "left"]].set_visible(False)
    axis.spines["bottom"].set_color(rgb(_GRID))
    axis.tick_params(colors=rgb(paint.FAINT), labelsize=9, length=0)


def rgb(color: paint.Color) -> tuple[float, float, float]:
    """Red, green, blue from 0 to 1."""
    blue, green, red = color
    return red / 255, green / 255, blue / 255
