"""Plots of the answers, as PNG files beside the results."""

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.stats import chi2

from benchmarks.score.metrics import percent, right, wilson_interval
from benchmarks.score.tables import by_confidence

GROUPS = {"realistic": "#1f5fbf", "world": "#d1603d"}
"""Plotted workloads, and their colours."""


def write_plots(frames: Mapping[str, pd.DataFrame], folder: Path) -> list[Path]:
    """Draw the plots for which there are answers; return the files."""
    plots: dict[str, tuple[str, Callable[[Figure, pd.DataFrame], None]]] = {
        "errors": ("accuracy", _errors),
        "visible": ("accuracy", _visible),
        "trust": ("accuracy", _trust),
        "times": ("accuracy", _times),
        "films": ("films", _films),
    }
    files = []
    for name, (part, draw) in plots.items():
        if part in frames and len(frames[part]):
            figure = Figure(figsize=(11, 4.2), dpi=110, layout="constrained")
            draw(figure, frames[part])
            files.append(folder / f"{name}.png")
            figure.savefig(files[-1])
    return files


def _panels(
    figure: Figure, frames: pd.DataFrame, **settings: Any
) -> Iterator[tuple[Axes, str, pd.DataFrame]]:
    """Yield the answers to each workload of an object, with its name and the object's panel to draw in."""
    shown = frames[frames.group.isin(list(GROUPS))]
    names = shown.object.unique()
    axes = figure.subplots(1, max(len(names), 1), squeeze=False)[0]
    for name, panel in zip(names, axes, strict=False):
        panel.set_title(name, loc="left")
        panel.grid(alpha=0.3)
        panel.set(**settings)
        for group, own in shown[shown.object == name].groupby("group", sort=False):
            yield panel, str(group), own
        panel.legend(frameon=False)


def _errors(figure: Figure, frames: pd.DataFrame) -> None:
    """Plot the share of all scenes with at most a given error; scenes without a pose count as larger."""
    labels = {"xlabel": "position error [mm]", "ylabel": "scenes within it [%]"}
    for panel, group, own in _panels(figure, frames, xscale="log", ylim=(0, 101), **labels):
        errors = np.sort(own.mm.dropna())
        share = 100 * np.arange(1, len(errors) + 1) / len(own)
        panel.step(errors, share, where="post", color=GROUPS[group], label=f"{group} ({len(own)})")


def _visible(figure: Figure, frames: pd.DataFrame) -> None:
    """Plot each scene as a point; crosses at the upper edge are scenes without a pose."""
    labels = {"xlabel": "visible fraction", "ylabel": "position error [mm]"}
    for panel, group, own in _panels(figure, frames, yscale="log", **labels):
        panel.plot(own.visible, own.mm, ".", ms=4, color=GROUPS[group], label=group)
        none = own[~own.found.astype(bool)]
        top = panel.get_xaxis_transform()
        panel.plot(none.visible, np.full(len(none), 1.0), "x", color=GROUPS[group], transform=top)


def _trust(figure: Figure, frames: pd.DataFrame) -> None:
    """Plot the share of right poses by stated confidence, with 95 % intervals, and a NEES histogram."""
    stated, spread = figure.subplots(1, 2)
    stated.plot([0, 100], [0, 100], color="grey", lw=1)
    for group, color in GROUPS.items():
        own = frames[frames.group == group]
        for _, rows in by_confidence(own):
            share = percent(right(rows))
            low, high = wilson_interval(share, len(rows))
            x = 100 * rows.confidence.mean()
            stated.plot([x, x], [low, high], color=color, lw=1)
            stated.plot([x], [share], "o", color=color, ms=4)
        values = own.nees.dropna()
        if len(values):
            bins = np.geomspace(0.05, 500, 40)
            spread.hist(values, bins, density=True, histtype="step", color=color, label=group)
    across = np.geomspace(0.05, 500, 400)
    spread.plot(across, chi2.pdf(across, 6), color="grey", label="if the covariance is right")
    stated.set(xlabel="stated confidence [%]", ylabel="within 5 mm and 5° [%]")
    spread.set(xscale="log", xlabel="NEES", ylabel="density")
    spread.legend(frameon=False)


def _times(figure: Figure, frames: pd.DataFrame) -> None:
    """Plot the share of scenes that take longer than a given multiple of the reference work."""
    labels = {"xlabel": "time of detect [× reference]", "ylabel": "slower [%]"}
    for panel, group, own in _panels(figure, frames, xscale="log", yscale="log", **labels):
        times = np.sort(own.ratio)
        slower = 100 * np.arange(len(times), 0, -1) / len(times)
        panel.step(times, slower, color=GROUPS[group], label=group)
        ticks = (1, 2, 5, 10, 20, 50, 100)
        panel.set_xticks(ticks, map(str, ticks))
        panel.minorticks_off()


def _films(figure: Figure, frames: pd.DataFrame) -> None:
    """Plot one tracked film for each object and kind: errors over time, and frames without a pose."""
    shown = frames[frames.group.isin(["all", "world"]) & (frames.film == 0)]
    groups = list(shown.groupby(["group", "object"], sort=False))
    panels = figure.subplots(2, 2, sharex="col", squeeze=False).ravel()
    for panel, ((group, name), own) in zip(panels, groups, strict=False):
        panel.plot(own.timestamp, own.measured_mm, ".", ms=3, color="#b0b7c3", label="measured")
        panel.plot(own.timestamp, own.mm, lw=1, color="#1f5fbf", label="filtered")
        gone = own[~own.found.astype(bool)]
        top = panel.get_xaxis_transform()
        panel.plot(gone.timestamp, np.full(len(gone), 1.0), "x", color="#d1603d", transform=top)
        panel.set_title(f"{name}, {group}", loc="left", fontsize=9)
        panel.set(yscale="log", ylabel="error [mm]")
        panel.grid(alpha=0.3)
    panels[0].legend(frameon=False, fontsize=8)
