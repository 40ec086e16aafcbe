"""How plots look: drawn once, in colours that the page's style sheet decides for light, dark and paper."""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

INK, FAINT, GRID, PAPER = "#010101", "#020202", "#030303", "#040404"
FIRST, SECOND, THIRD, FOURTH, FIFTH, SIXTH = "#050505", "#060606", "#070707", "#080808", "#090909", "#0a0a0a"
"""Placeholders that `svg` turns into variables of the style sheet."""

SERIES = (FIRST, SECOND, THIRD, FOURTH, FIFTH, SIXTH)
"""For anything that has no colour of its own."""

_VARIABLES = {
    INK: "ink",
    FAINT: "faint",
    GRID: "grid",
    PAPER: "paper",
    **{color: f"series-{number}" for number, color in enumerate(SERIES, start=1)},
}

_STYLE = Path(__file__).with_name("theme.mplstyle")


@contextmanager
def _style(name: str) -> Iterator[None]:
    # The salt makes the picture's identifiers its own, and the same in each run.
    with mpl.rc_context({"svg.hashsalt": name}, fname=_STYLE):
        yield


def svg(name: str, alt: str, size: tuple[float, float], draw: Callable[[Figure], None]) -> str:
    """An SVG element for a page, with the page's fonts and colours.

    Args:
        name: unlike that of any other picture of the page; letters, digits and hyphens.
        alt: what it shows, for those who do not see it.
        size: width and height [inch at 96 px].
        draw: draws into a figure.
    """
    with _style(name):
        figure = Figure(figsize=(size[0], size[1]), dpi=96)
        FigureCanvasSVG(figure)
        draw(figure)
        stream = io.StringIO()
        figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
    return _inline(stream.getvalue(), name, alt)


def _inline(text: str, name: str, alt: str) -> str:
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    for color, variable in _VARIABLES.items():
        text = re.sub(re.escape(color), f"var(--{variable})", text, flags=re.IGNORECASE)
    text = re.sub(r"'DejaVu Sans'(, [^;\"]*)?", "var(--font)", text)
    text = re.sub(r'\bid="([^"]*)"', rf'id="{name}-\1"', text)
    text = re.sub(r'\bhref="#([^"]*)"', rf'href="#{name}-\1"', text)
    text = re.sub(r"url\(#([^)]*)\)", rf"url(#{name}-\1)", text)
    # The page sets the width; the view box keeps the proportions.
    text = re.sub(r'<svg\b([^>]*?) height="[^"]*"', r"<svg\1", text, count=1)
    text = re.sub(r'<svg\b([^>]*?) width="[^"]*"', r"<svg\1", text, count=1)
    safe = alt.replace("&", "&amp;").replace('"', "&quot;").replace("<", "&lt;")
    return text.replace("<svg", f'<svg role="img" aria-label="{safe}"', 1)


_SHORT = 60.0
"""Ratio of the ends of an axis below which powers of ten are too few ticks."""


def plain_ticks(axes: Axes, which: str) -> None:
    """Ticks of a logarithmic axis as plain numbers, once it has its limits: more where it is short."""
    axis = axes.xaxis if which == "x" else axes.yaxis
    low, high = axes.get_xlim() if which == "x" else axes.get_ylim()
    subs = (1.0, 2.0, 5.0) if high < _SHORT * low else (1.0,)
    axis.set_major_locator(LogLocator(subs=subs))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def legend_above(figure: Figure, *panels: Axes) -> None:
    """One legend above all panels, with each label once."""
    entries: dict[str, Any] = {}
    for axes in panels:
        handles, labels = axes.get_legend_handles_labels()
        for handle, label in zip(handles, labels, strict=True):
            entries.setdefault(label, handle)
    figure.legend(
        handles=list(entries.values()), loc="outside upper left", ncols=len(entries), markerscale=1.6
    )
