"""A film of each object as it was tracked: errors and status over time, as a picture."""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from benchmarks.report import theme
from tracker.files import write_whole

FILE = "films.png"
"""The picture, in the folder of the results."""

MEASURED, FILTERED, GRID = "#b0b7c3", "#1f5fbf", "#e4e6ea"
STATUSES = ("FOUND", "TRACKING", "REFOUND", "COASTING", "LOST")


def write_film_plot(shown: Mapping[str, pd.DataFrame], folder: Path) -> Path:
    """Draw the films by the names of their objects; returns the file."""
    figure = Figure(figsize=(6.4 * len(shown), 6.4), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(3, len(shown), sharex="col", squeeze=False, height_ratios=(3, 3, 2))
    for column, (name, played) in zip(panels.T, shown.items(), strict=True):
        _draw(column, name, played)
    theme.legend_above(figure, panels[0, 0])
    stream = io.BytesIO()
    figure.savefig(stream, format="png")
    file = folder / FILE
    write_whole(file, stream.getvalue())
    return file


def _draw(column: np.ndarray[tuple[int], np.dtype[np.object_]], name: str, played: pd.DataFrame) -> None:
    shift, turn, status = column
    for axes, unit, label in ((shift, "mm", "position error [mm]"), (turn, "deg", "rotation error [°]")):
        style = {"ms": 2.5, "ls": "none", "marker": "o", "color": MEASURED}
        axes.plot(played.timestamp, played[f"measured_{unit}"], label="measured", **style)
        axes.plot(played.timestamp, played[f"filtered_{unit}"], label="filtered", color=FILTERED, lw=1.1)
        if played[[f"measured_{unit}", f"filtered_{unit}"]].notna().to_numpy().any():
            axes.set_yscale("log")
            theme.plain_ticks(axes, "y")
        axes.set_ylabel(label)
        _plain(axes)
    places = [STATUSES.index(name) if name in STATUSES else -1 for name in played.status]
    status.plot(played.timestamp, places, ls="none", marker="|", ms=9, color=FILTERED)
    status.set_yticks(range(len(STATUSES)), [name.lower() for name in STATUSES])
    status.set_ylim(len(STATUSES) - 0.5, -0.5)
    status.set_xlabel("time [s]")
    _plain(status)
    shift.set_title(name, loc="left", fontsize=11, fontweight="bold")


def _plain(axes: Axes) -> None:
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(color=GRID, lw=0.7)
    axes.set_axisbelow(True)
