"""Figures of matplotlib, an optional package, as files."""

from __future__ import annotations

import io
import os
from pathlib import Path
from typing import TYPE_CHECKING

from tracker.errors import ImageError, TrackerError, install
from tracker.files import told_as, write_whole
from tracker.viz import paint
from tracker.viz.plots import rgb

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DPI = 130
"""Pixels for each inch of a figure."""


def figure_for(path: str | os.PathLike[str], size: tuple[float, float]) -> Figure:
    """An empty figure of a size [inch] that can be written to a file.

    Raises:
        ImageError: the file's suffix is not .png.
        TrackerError: the optional package `matplotlib` is missing.
    """
    target = Path(path)
    if target.suffix.lower() != ".png":
        raise ImageError(f"plot {target}: found suffix {target.suffix!r}, expected .png")
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise TrackerError(f"plots need the package matplotlib: {install('plot')}") from error
    # Not of pyplot: no window system, and no figure that stays in memory.
    return Figure(figsize=size, dpi=DPI, facecolor=rgb(paint.BACKGROUND), layout="constrained")


def write_figure(path: str | os.PathLike[str], figure: Figure) -> None:
    """Write a figure as a PNG picture, whole or not at all.

    Raises:
        ImageError: the file cannot be written.
    """
    content = io.BytesIO()
    figure.savefig(content, format="png", facecolor=figure.get_facecolor())
    with told_as(ImageError, f"plot {Path(path)}"):
        write_whole(Path(path), content.getvalue())
