"""Figures of matplotlib, an optional package: dark like the other pictures, and written whole.

One is of an object's face colours: what is taken for what, and how near they are.
"""

from __future__ import annotations

import io
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tracker.checks import optional
from tracker.conventions import Array, FloatArray
from tracker.errors import ImageError
from tracker.files import check_suffix, told_as, write_whole
from tracker.objects.labels import COLOR_NAMES, DISPLAY_COLORS_BGR
from tracker.viz import paint

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_GRID: paint.Color = (58, 51, 47)


def rgb(color: paint.Color) -> tuple[float, float, float]:
    """Red, green, blue from 0 to 1."""
    blue, green, red = color
    return red / 255, green / 255, blue / 255


_STYLE: Any = {
    **dict.fromkeys(("figure.facecolor", "savefig.facecolor", "axes.facecolor"), rgb(paint.BACKGROUND)),
    **dict.fromkeys(("text.color", "axes.labelcolor", "legend.labelcolor"), rgb(paint.FAINT)),
    **dict.fromkeys(("xtick.color", "ytick.color"), rgb(paint.FAINT)),
    **dict.fromkeys(("axes.edgecolor", "grid.color"), rgb(_GRID)),
    **dict.fromkeys(("xtick.labelsize", "ytick.labelsize", "legend.fontsize"), 9),
    **dict.fromkeys(("xtick.major.size", "ytick.major.size"), 0),
    **dict.fromkeys(("axes.spines.top", "axes.spines.right", "axes.spines.left", "legend.frameon"), False),
    "axes.grid": True,
    "axes.axisbelow": True,
    "figure.dpi": 130,
    "savefig.dpi": 130,
}
"""What differs from matplotlib's own look: dark, with a faint grid and few lines."""


@contextmanager
def figure(size: tuple[float, float]) -> Iterator[Figure]:
    """An empty figure of a size [inch]; TrackerError where the package `matplotlib` is missing."""
    made = optional("matplotlib.figure", "plot", "a plot").Figure
    with optional("matplotlib", "plot", "a plot").rc_context(_STYLE):
        # Not of pyplot: no window system, and no figure that stays in memory.
        yield made(figsize=size, layout="constrained")


@contextmanager
def figure_file(path: str | os.PathLike[str], size: tuple[float, float]) -> Iterator[Figure]:
    """As `figure`; at the end of the `with` block it is written as a PNG picture, whole or not at all."""
    target = Path(path)
    check_suffix(target, (".png",), "plot", ImageError)
    with figure(size) as drawn:
        yield drawn
        content = png(drawn)
    with told_as(ImageError, f"plot {target}"):
        write_whole(target, content)


def png(drawn: Figure) -> bytes:
    """The figure as a PNG picture."""
    content = io.BytesIO()
    drawn.savefig(content, format="png")
    return content.getvalue()


SIZE = (12.0, 5.4)
"""Width and height of the picture [inch]."""

_DOTS = 500
"""Pixels of each colour that are drawn."""


def write_colors_plot(
    path: str | os.PathLike[str],
    counts: Array,
    pixels: Mapping[int, Array],
    better: Mapping[int, FloatArray],
    title: str,
) -> None:
    """Write a PNG picture of a confusion and of where the colours lie, whole or not at all.

    Args:
        path: ends in .png.
        counts: (7, 7) pixels by true label and label found.
        pixels: (N, 3) levels BGR in neutral light by label.
        better: (3,) levels BGR of a better set of colours by label.
        title: stands above.

    Raises:
        ImageError: the suffix is another, or the file cannot be written.
        TrackerError: the optional package `matplotlib` is missing.
    """
    with figure_file(path, SIZE) as figure:
        figure.suptitle(title, color=rgb(paint.BRIGHT), fontsize=12)
        left, right = figure.subplots(1, 2, width_ratios=(1, 1.15))
        _draw_confusion(left, counts)
        _draw_colors(right, pixels, better)


def _draw_confusion(axis: Any, counts: Array) -> None:
    """Shares of each true colour's pixels, by what they are found as."""
    order = [*range(1, len(COLOR_NAMES)), 0]
    names = [*COLOR_NAMES[1:], "none"]
    sums = counts.sum(axis=1, keepdims=True)
    shares = (counts / np.maximum(sums, 1))[np.ix_(order, order)]
    axis.grid(False)
    axis.imshow(np.sqrt(shares), cmap="magma", vmin=0, vmax=1, aspect="auto")
    for row, column in np.ndindex(shares.shape):
        share = shares[row, column]
        if share > 0:
            color = paint.BACKGROUND if share > 0.5 else paint.BRIGHT
            text = f"{100 * share:.0f}" if share >= 0.01 else "<1"
            axis.text(column, row, text, ha="center", va="center", fontsize=9, color=rgb(color))
    axis.set_xticks(range(len(names)), names)
    axis.set_yticks(range(len(names)), names)
    axis.set_xlabel("found as [% of the pixels]")
    axis.set_ylabel("is")


def _draw_colors(axis: Any, pixels: Mapping[int, Array], better: Mapping[int, FloatArray]) -> None:
    """The colours' chromaticities around that of the light."""
    for label, some in pixels.items():
        blue, green, red = DISPLAY_COLORS_BGR[label].tolist()
        color = rgb((blue, green, red))
        axis.plot(*_chroma(some[:: len(some) // _DOTS + 1]), ".", markersize=3, alpha=0.35, color=color)
        axis.plot(
            *_chroma(np.median(some, axis=0)[None]), "o", markersize=9, color=color, label=COLOR_NAMES[label]
        )
        axis.plot(*_chroma(better[label][None]), "o", markersize=12, fillstyle="none", color=color)
    axis.plot(0, 0, "+", markersize=14, color=rgb(paint.BRIGHT))
    axis.annotate(
        "light, grey", (0, 0), (6, 6), textcoords="offset points", color=rgb(paint.BRIGHT), fontsize=9
    )
    axis.set_xlabel("log red / green  (rings: a better set)")
    axis.set_ylabel("log blue / green")


def _chroma(levels: Array) -> tuple[FloatArray, FloatArray]:
    """Log red over green and log blue over green of levels (N, 3); the dark are drawn towards grey."""
    logs = np.log(np.asarray(levels, dtype=np.float64) + 6.0)
    return logs[:, 2] - logs[:, 1], logs[:, 0] - logs[:, 1]
