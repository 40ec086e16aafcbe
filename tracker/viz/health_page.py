"""The health of a rig over a recording, as a page that needs no other file."""

from __future__ import annotations

import base64
import os
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from tracker.calibration.by_object.health import HEIGHT, OFTEN, QUANTITIES, Health, Quantity
from tracker.conventions import FloatArray
from tracker.files import write_whole
from tracker.viz import paint
from tracker.viz.plots import figure, png, rgb

COLORS: tuple[paint.Color, ...] = (
    (110, 120, 240), (125, 205, 125), (245, 165, 95), (225, 200, 90), (210, 140, 200), (90, 215, 250),
)  # fmt: skip
"""Of the cameras, in their order."""

_STYLE = """
body { background: #16181d; color: #d8dadd; font: 15px/1.5 sans-serif; max-width: 1100px; margin: 2em auto; }
table { border-collapse: collapse; } td, th { padding: 0.2em 1em 0.2em 0; text-align: right; }
td:first-child, th:first-child { text-align: left; } .bad { color: #f56e50; } .good { color: #6ec878; }
img { width: 100%; } h2 { font-size: 1em; margin: 2em 0 0; } p.limit { color: #8c949e; margin: 0; }
"""


def write_health(path: str | os.PathLike[str], health: Health, title: str) -> None:
    """Write a page (.html) with a plot over time of all that was measured, whole or not at all.

    Raises:
        TrackerError: the optional package `matplotlib` is missing, or the file cannot be written.
    """
    write_whole(Path(path), page(health, title).encode())


def page(health: Health, title: str) -> str:
    """The page."""
    complaints = health.complaints()
    verdict = "".join(f'<li class="bad">{escape(line)}</li>' for line in complaints)
    parts = [
        f"<h1>{escape(title)}</h1>",
        f"<ul>{verdict}</ul>" if complaints else '<p class="good">Nothing to complain of.</p>',
        _table(health),
    ]
    for key, quantity in QUANTITIES.items():
        parts.append(_section(quantity, health.time, health.values[key], health.cameras))
    parts.append(_section(HEIGHT, health.time, health.height[:, None], ("object",)))
    head = f'<meta charset="utf-8"><title>{escape(title)}</title><style>{_STYLE}</style>'
    return f"<!DOCTYPE html>\n<html><head>{head}</head><body>\n" + "\n".join(parts) + "\n</body></html>\n"


def _table(health: Health) -> str:
    """Medians, red where a limit is exceeded too often."""
    rows = [
        "<tr><th></th>" + "".join(f"<th>{escape(name)}</th>" for name in health.cameras) + "<th></th></tr>"
    ]
    for key, quantity in QUANTITIES.items():
        cells = [
            f'<td class="{"bad" if share > OFTEN else ""}">{_median(column)}</td>'
            for column, share in zip(health.values[key].T, health.beyond(key), strict=True)
        ]
        rows.append(f"<tr><td>{key}</td>{''.join(cells)}<td>{escape(quantity.unit)}</td></tr>")
    return f"<table>{''.join(rows)}</table>"


def _median(values: FloatArray) -> str:
    known = values[np.isfinite(values)]
    return f"{np.median(known):.2f}" if known.size else "–"


def _section(quantity: Quantity, time: FloatArray, values: FloatArray, names: tuple[str, ...]) -> str:
    low, high = quantity.limits
    picture = base64.b64encode(_plot(quantity, time, values, names)).decode()
    limit = f"well from {low:g} to {high:g} {escape(quantity.unit)}; else {escape(quantity.advice)}"
    return (
        f'<h2>{escape(quantity.title)}</h2><p class="limit">{limit}</p>'
        f'<img alt="{escape(quantity.title)}" src="data:image/png;base64,{picture}">'
    )


def _plot(quantity: Quantity, time: FloatArray, values: FloatArray, names: tuple[str, ...]) -> bytes:
    """A PNG of one quantity over time, a line for each camera, limits dashed."""
    with figure((11.0, 2.2)) as picture:
        axis: Any = picture.subplots()
        for c, name in enumerate(names):
            axis.plot(
                time, values[:, c], ".-", color=rgb(COLORS[c % len(COLORS)]), linewidth=1, ms=4, label=name
            )
        known = values[np.isfinite(values)]
        for limit in quantity.limits:
            # A limit that is far away would flatten the lines.
            if (
                limit != 0.0
                and known.size
                and known.min() - np.ptp(known) - 1 <= limit <= known.max() + np.ptp(known) + 1
            ):
                axis.axhline(limit, color=rgb(paint.FAINT), linewidth=1, linestyle="--")
        axis.set_xlabel("time [s]")
        axis.set_ylabel(quantity.unit, fontsize=8)
        axis.legend(ncols=len(names))
        return png(picture)
