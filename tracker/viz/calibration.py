"""Rig health: each camera's residuals relative to the others or to a board, and a page of plots over time."""

import base64
from collections.abc import Sequence
from html import escape
from typing import Any

import numpy as np

from tracker.calibration.by_object.check import LIMIT, CalibrationCheck, CameraCheck
from tracker.calibration.by_object.health import HEIGHT, OFTEN, QUANTITIES, Health, Quantity
from tracker.calibration.rig import CameraRig
from tracker.conventions import FloatArray, Image
from tracker.viz import paint
from tracker.viz.overlays import GOOD
from tracker.viz.plots import figure, png, rgb

BAD: paint.Color = (80, 110, 245)

_SIDE, _HEAD = 420, 76
"""Size of a camera's panel and height of the text above it [px]."""

_SHOWN = 4.0  # range of a panel [limits]
_WIDTH = 1080  # width of the image of residuals [px]
_STRIP = 40  # height of the line of text below [px]
_LONG = 0.02  # length of a line that shows the RMS [image widths]


def check_picture(found: CalibrationCheck, rig: CameraRig) -> Image:
    """Return an image (H, W, 3) BGR with a panel for each camera, and a dot for each look.

    A dot's offset from the centre is the distance in the image between the object as the camera sees it and
    as the others see it; the ring is the limit.
    """
    picture = paint.canvas(_SIDE * len(rig), _SIDE + _HEAD)
    for c, (camera, one) in enumerate(zip(rig, found.cameras, strict=True)):
        limit = LIMIT * float(np.sqrt(camera.matrix[0, 0] * camera.matrix[1, 1]))
        panel = picture[:, c * _SIDE : (c + 1) * _SIDE]
        color = BAD if one.moved or found.is_lost(one) else GOOD
        paint.put_text(panel, one.name, (16, 26), paint.BRIGHT, size=12)
        paint.put_text(panel, verdict(found, one), (16, 50), color, size=9)
        _dots(panel[_HEAD:], found.misses[:, c], limit, color)
        paint.put_text(panel, f"ring: {limit:.1f} px", (16, _HEAD + _SIDE - 12), paint.FAINT, size=9)
    return picture


def verdict(found: CalibrationCheck, one: CameraCheck) -> str:
    """Return the verdict on a camera in one line."""
    if one.moved:
        return f"moved: {one.shift_mm:.1f} mm, {one.turn_deg:.2f}°"
    if found.is_lost(one):
        return "should see the object, and cannot use what it shows"
    return "not checked" if np.isnan(one.miss_px) else f"misses the others by {one.miss_px:.2f} px"


def _dots(panel: Image, misses: FloatArray, limit: float, color: paint.Color) -> None:
    half = _SIDE / 2
    scale, middle = half / (_SHOWN * limit), np.array([half, half])
    cross = [np.array([(0, half), (_SIDE, half)]), np.array([(half, 0), (half, _SIDE)])]
    paint.stroke(panel, cross, paint.FAINT, 1.0, 0.4)
    paint.stroke(panel, [paint.circle(middle, limit * scale)], paint.FAINT, 1.5)
    for miss in misses[np.isfinite(misses).all(axis=1)]:
        at = middle + np.clip(miss * scale, 6 - half, half - 6)
        paint.fill(panel, paint.circle(at, 4.0), color, 0.8)


def residual_picture(
    title: str, size: tuple[int, int], photos: Sequence[tuple[FloatArray, FloatArray, bool]]
) -> Image:
    """Return an image (H, W, 3) BGR with the residuals of all photos of a camera, above a title.

    `size` is the photos' width and height [px]. Each photo has its corners (N, 2) [px], their residuals
    (N, 2) [px], and whether the calibration used it; the lines of unused photos are red.
    """
    scale = _WIDTH / size[0]
    height = round(size[1] * scale)
    picture = paint.canvas(_WIDTH, height + _STRIP)
    used = [missed for _, missed, counts in photos if counts]
    rms = float(np.sqrt((np.concatenate(used) ** 2).sum(axis=1).mean())) if used else 0.0
    longer = _LONG * _WIDTH / max(rms, 1e-6)
    for pixels, missed, counts in photos:
        color = GOOD if counts else BAD
        starts = (pixels + 0.5) * scale - 0.5
        far = np.maximum(np.linalg.norm(missed, axis=1, keepdims=True), 1e-9)
        ends = starts + missed * np.minimum(longer, _WIDTH / 4 / far)
        paint.stroke(picture[:height], list(np.stack([starts, ends], axis=1)), color, 1.5)
        paint.stroke(picture[:height], [paint.circle(start, 2.0) for start in starts], color, 1.0)
    left, bar = 16, longer * rms
    paint.stroke(picture, [np.array([[left, height + 20.0], [left + bar, height + 20.0]])], paint.BRIGHT, 2.0)
    at = (left + bar + 12, height + 25.0)
    paint.put_text(picture, f"{rms:.2f} px RMS   {title}", at, paint.BRIGHT, size=11)
    return picture


COLORS: tuple[paint.Color, ...] = (
    (245, 165, 95), (125, 205, 125), (210, 140, 200), (225, 200, 90), (90, 215, 250), (158, 148, 140),
)  # fmt: skip
"""Colours of the cameras, in order; none is red, which marks values beyond a limit."""

_STYLE = """
body { background: #16181d; color: #d8dadd; font: 15px/1.5 sans-serif; max-width: 1100px; }
body { margin: 2em auto; padding: 0 1em; }
table { border-collapse: collapse; } td, th { padding: 0.2em 1em 0.2em 0; text-align: right; }
td:first-child, th:first-child { text-align: left; } .bad { color: #f56e50; } .good { color: #6ec878; }
div { overflow-x: auto; } img { width: 100%; min-width: 640px; }
h2 { font-size: 1em; margin: 2em 0 0; } p.limit { color: #8c949e; margin: 0; }
"""
_META = '<meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">'


def page(health: Health, title: str) -> str:
    """Return a page in HTML that plots all quantities over time; TrackerError if matplotlib is missing."""
    missing = health.missing()
    parts = [f"<h1>{escape(title)}</h1>"]
    if lines := [f'<li class="bad">{escape(line)}</li>' for line in health.complaints()]:
        parts.append(f"<ul>{''.join(lines)}</ul>")
    else:
        what = "What was measured" if missing else "Everything"
        parts.append(f'<p class="good">{what} is within its limits in most frames.</p>')
    if missing:
        parts.append(f'<p class="limit">{escape(missing[0].upper() + missing[1:])}.</p>')
    parts.append(_table(health))
    for key, quantity in QUANTITIES.items():
        parts.append(_section(quantity, health.time, health.values[key], health.cameras))
    parts.append(_section(HEIGHT, health.time, health.height[:, None], ("object",)))
    head = f"{_META}<title>{escape(title)}</title><style>{_STYLE}</style>"
    return f"<!DOCTYPE html>\n<html><head>{head}</head><body>\n" + "\n".join(parts) + "\n</body></html>\n"


def _table(health: Health) -> str:
    """Return a table of medians, red if the limits are exceeded too often."""
    names = "".join(f"<th>{escape(name)}</th>" for name in health.cameras)
    rows = [f"<tr><th></th>{names}<th></th></tr>"]
    for key, quantity in QUANTITIES.items():
        cells = []
        for column, share in zip(health.values[key].T, health.beyond(key), strict=True):
            known = column[np.isfinite(column)]
            median = _readable(float(np.median(known)), 2) if known.size else "–"
            cells.append(f'<td class="{"bad" if share > OFTEN else ""}">{median}</td>')
        rows.append(f"<tr><td>{key}</td>{''.join(cells)}<td>{escape(quantity.unit)}</td></tr>")
    return f"<div><table>{''.join(rows)}</table></div>"


def _readable(value: float, digits: int = 1) -> str:
    """Return a number with few decimals and without trailing zeros: 5.42373 as 5.4, 30.0 as 30."""
    return f"{round(value, digits) + 0.0:g}".replace("-", "−")


def _section(quantity: Quantity, time: FloatArray, values: FloatArray, names: tuple[str, ...]) -> str:
    low, high = map(_readable, quantity.limits)
    title, unit, advice = map(escape, (quantity.title, quantity.unit, quantity.advice))
    if not np.isfinite(values).any():
        return f'<h2>{title}</h2><p class="limit">not measured</p>'
    picture = base64.b64encode(_plot(quantity, time, values, names)).decode()
    limit = f'<p class="limit">limits: {low} to {high} {unit}; if beyond: {advice}</p>'
    image = f'<div><img alt="{title}" src="data:image/png;base64,{picture}"></div>'
    return f"<h2>{title}</h2>{limit}{image}"


def _plot(quantity: Quantity, time: FloatArray, values: FloatArray, names: tuple[str, ...]) -> bytes:
    """Return a PNG of one quantity over time: a line per camera, dashed limits, values beyond them in red."""
    low, high = quantity.limits
    with figure((11.0, 2.2)) as picture:
        axis: Any = picture.subplots()
        for c, name in enumerate(names):
            color = rgb(COLORS[c % len(COLORS)])
            axis.plot(time, values[:, c], ".-", color=color, linewidth=1, ms=4, label=name)
        beyond = np.where((values < low) | (values > high), values, np.nan)
        axis.plot(time, beyond, ".", color=rgb(BAD), ms=6)
        known = values[np.isfinite(values)]
        for limit in quantity.limits:
            # A limit far from the values would flatten the lines.
            if limit != 0.0 and known.min() - np.ptp(known) - 1 <= limit <= known.max() + np.ptp(known) + 1:
                axis.axhline(limit, color=rgb(paint.FAINT), linewidth=1, linestyle="--")
        if len(time) > 1 and np.ptp(time) > 0:
            room = 0.01 * np.ptp(time)
            axis.set_xlim(time.min() - room, time.max() + room)  # the same range in all plots
        axis.set_xlabel("time [s]")
        axis.set_ylabel(quantity.unit, fontsize=8)
        axis.yaxis.set_label_coords(-0.05, 0.5)
        axis.legend(ncols=min(len(names), 6), loc="lower right", bbox_to_anchor=(1, 1), borderaxespad=0)
        return png(picture)
