"""Figures of matplotlib, an optional package: dark like the other pictures, and written whole."""

from __future__ import annotations

import io
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tracker.errors import ImageError, TrackerError, install
from tracker.files import told_as, write_whole
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
    """An empty figure of a size [inch], to be drawn on in the with block.

    Raises:
        TrackerError: the optional package `matplotlib` is missing.
    """
    try:
        from matplotlib import rc_context
        from matplotlib.figure import Figure
    except ImportError as error:
        raise TrackerError(f"plots need the package matplotlib: {install('plot')}") from error
    with rc_context(_STYLE):
        # Not of pyplot: no window system, and no figure that stays in memory.
        yield Figure(figsize=size, layout="constrained")


@contextmanager
def figure_file(path: str | os.PathLike[str], size: tuple[float, float]) -> Iterator[Figure]:
    """As `figure`; where the with block ends it is written as a PNG picture, whole or not at all.

    Raises:
        ImageError: the file's suffix is not .png, or it cannot be written.
        TrackerError: the optional package `matplotlib` is missing.
    """
    target = Path(path)
    if target.suffix.lower() != ".png":
        raise ImageError(f"plot {target}: found suffix {target.suffix!r}, expected .png")
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
