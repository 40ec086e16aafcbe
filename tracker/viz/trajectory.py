"""Where the object was over a whole recording, how sure that is, and what the tracker was doing."""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np

from tracker.conventions import Array, FloatArray
from tracker.geometry import so3
from tracker.poses.columns import PoseColumns
from tracker.poses.poses import Poses
from tracker.summaries.summary import best
from tracker.viz import paint
from tracker.viz.overlays import DOUBTFUL, GOOD
from tracker.viz.plots import figure_file, rgb

SIZE = (12.0, 10.0)
"""Width and height of the picture [inch]."""

_AXES: dict[str, paint.Color] = {"x": (110, 120, 240), "y": (125, 205, 125), "z": (245, 165, 95)}
_ROTATION: paint.Color = (210, 140, 200)
_RECORDED: paint.Color = (90, 215, 250)
_SIGMAS = 2.0

STATUS_COLORS: dict[str, paint.Color] = {
    "tracking": GOOD,
    "found": (160, 225, 195),
    "refound": (225, 200, 90),
    "coasting": DOUBTFUL,
    "lost": (95, 85, 225),
    "no_object_colors": (105, 98, 92),
    "too_few_pixels": (170, 150, 200),
    "inconsistent_views": (180, 110, 150),
    "poor_fit": (185, 140, 90),
    "other_object": (120, 60, 110),
    "ambiguous": (70, 120, 150),
}
"""The colours of a status strip, the same in each plot."""

_LABEL_X = -0.065  # left of the longest tick label, so that the labels of all panels are aligned
_LEAST_SHARE = 0.003
"""Share of the strip's width that the shortest run has, so that single frames are seen."""
_LEAST = 2.0
"""Least height of an axis that is fitted to its values."""
_FEW = 250
"""Frames up to which dots are drawn in full size."""


def write_trajectory_plot(path: str | os.PathLike[str], poses: Poses, title: str = "") -> None:
    """Write a PNG picture of position, rotation, confidence and status over time, whole or not at all.

    Lines are the filtered poses with a band of two standard deviations, dots the measured ones, circles
    those of the recording; without any filtered pose the lines are the measured ones. The rotation is the
    angle from the first pose.

    Args:
        path: ends in .png.
        poses: what to show.
        title: stands above; by default object and source.

    Raises:
        ImageError: the suffix is another, or the file cannot be written.
        TrackerError: the optional package `matplotlib` is missing.
    """
    title = title or " · ".join(filter(None, (poses.about.object_name, poses.about.source)))
    with warnings.catch_warnings(), figure_file(path, SIZE) as figure:
        warnings.filterwarnings("ignore", "Glyph")  # a title may hold any character
        _draw(figure, poses, title)


def _draw(figure: Any, poses: Poses, title: str) -> None:
    time = poses.timestamp - poses.timestamp[:1]
    figure.get_layout_engine().set(h_pad=0.05, hspace=0.02, rect=(0.012, 0.012, 0.972, 0.974))
    axes = figure.subplots(6, 1, sharex=True, height_ratios=(0.32, 2, 2, 2, 2, 1.3))
    _draw_status(axes[0], time, poses.status)
    panels = zip(axes[1:], _to_one_scale(list(_series(poses))), strict=True)
    drawn, *_ = [_draw_panel(axis, time, series) for axis, series in panels]
    axes[5].set_xlabel("time since the first frame [s]")
    if len(poses) > 1 and time.max() > time.min():
        axes[0].set_xlim(time.min(), time.max())
    elif not len(poses):
        axes[0].set_xticks([])
    found = best(poses).has_pose
    share = f"{np.mean(found):.1%} of {len(poses)} frames have a pose" if len(poses) else "no frames"
    # A dollar sign in the name of a file begins no formula.
    heading = title.replace("$", r"\$")
    axes[0].set_title(heading, loc="left", color=rgb(paint.BRIGHT), fontsize=14, pad=30)
    axes[0].set_title(share, loc="right", fontsize=10, pad=30)
    fused, recorded = bool(poses.filtered.has_pose.any()), poses.recorded is not None
    some, both = bool(found.any()), fused and bool(poses.measured.has_pose.any())
    names = ("filtered" if fused else "measured", f"±{_SIGMAS:g}σ", "measured", "recorded")
    there = zip(drawn, names, (some, some, both, recorded), strict=True)
    _explain(axes[1], {name: one for one, name, is_there in there if is_there}, "right")


def _series(poses: Poses) -> Iterator[Series]:
    shown, measured = best(poses), poses.measured
    recorded = PoseColumns.nothing(len(poses)) if poses.recorded is None else poses.recorded
    for k, (name, color) in enumerate(_AXES.items()):
        line, dots, circles = (1e3 * columns.position[:, k] for columns in (shown, measured, recorded))
        band = 1e3 * _SIGMAS * np.sqrt(shown.covariance[:, k, k])
        yield Series(f"{name} [mm]", color, line, line - band, line + band, dots, circles)
    posed = next((columns for columns in (shown, measured, recorded) if columns.has_pose.any()), None)
    first = (
        np.eye(3)
        if posed is None
        else so3.matrix_from_quaternion(posed.orientation[np.argmax(posed.has_pose)])
    )
    line, dots, circles = (angles(columns.orientation, first) for columns in (shown, measured, recorded))
    band = _SIGMAS * angle_std(shown.orientation, first, shown.covariance[:, 3:, 3:])
    low, high = np.maximum(line - band, 0), np.minimum(line + band, 180)
    yield Series("rotation [°]", _ROTATION, line, low, high, dots, circles)
    nothing = np.full(len(poses), np.nan)
    line, dots, circles = (columns.confidence for columns in (shown, measured, recorded))
    limits = (-0.04, 1.04)
    yield Series("confidence", paint.BRIGHT, line, nothing, nothing, dots, circles, limits)


def _to_one_scale(all_series: list[Series]) -> list[Series]:
    """The series with x, y and z over axes of one length, so that equal motions look equal."""
    limits = np.array([_limits(series) for series in all_series[: len(_AXES)]])
    half = np.ptp(limits, axis=1).max() / 2
    middles = limits.mean(axis=1)
    scaled = [
        series._replace(limits=(middle - half, middle + half))
        for series, middle in zip(all_series, middles, strict=False)
    ]
    return scaled + all_series[len(_AXES) :]


def angles(orientation: FloatArray, reference: FloatArray) -> FloatArray:
    """Angles (n,) [°] of quaternions (n, 4) from a rotation (3, 3); NaN where the quaternion is."""
    result: FloatArray = np.degrees(np.linalg.norm(_rotation_vectors(orientation, reference), axis=1))
    return result


def angle_std(orientation: FloatArray, reference: FloatArray, covariance: FloatArray) -> FloatArray:
    """Standard deviations (n,) [°] of `angles`, from covariances (n, 3, 3) [rad²] along world axes.

    With R = exp(δθ) R̂ the angle changes by axis · δθ, the axis being that of R̂ Rᵀ_reference. Near zero the
    axis is anything: there the largest deviation is given.
    """
    vector = _rotation_vectors(orientation, reference)
    rows = np.flatnonzero(np.isfinite(vector).all(axis=1))
    vector, spread = vector[rows], covariance[rows]
    length = np.linalg.norm(vector, axis=1)
    axis = vector / np.where(length > 0, length, 1)[:, None]
    along = np.einsum("ni,nij,nj->n", axis, spread, axis)
    largest = np.linalg.eigvalsh(spread).max(axis=1, initial=0)
    variance = np.where(length < 3 * np.sqrt(largest), largest, along)
    result = np.full(len(orientation), np.nan)
    result[rows] = np.degrees(np.sqrt(np.maximum(variance, 0)))
    return result


def _rotation_vectors(orientation: FloatArray, reference: FloatArray) -> FloatArray:
    """Rotation vectors (n, 3) [rad] from the reference, along world axes; NaN where the quaternion is."""
    result = np.full((len(orientation), 3), np.nan)
    rows = np.isfinite(orientation).all(axis=1)
    result[rows] = so3.log(so3.matrix_from_quaternion(orientation[rows]) @ reference.T)
    return result


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
    limits: tuple[float, float] | None = None
    """Of the axis; None: fitted to the values, and not to the band, which can reach very far."""

    @property
    def values(self) -> FloatArray:
        """(k,) all that are finite of line, dots and circles."""
        values: FloatArray = np.concatenate([self.line, self.dots, self.circles])
        known: FloatArray = values[np.isfinite(values)]
        return known


def _draw_panel(axis: Any, time: Array, series: Series) -> tuple[Any, ...]:
    """Draw a line with a band, dots and circles over time; these four, for a legend."""
    color = rgb(series.color)
    size = float(np.clip(np.sqrt(_FEW / max(len(time), 1)), 0.5, 1))
    bottom, top = _limits(series)
    # A variance may have any size, a pixel's place may not.
    far = 10 * (top - bottom)
    low, high = (np.clip(end, bottom - far, top + far) for end in (series.low, series.high))
    band = axis.fill_between(time, low, high, color=color, alpha=0.3, linewidth=0)
    ring = {"ms": 3.8 * size, "mew": 0.9 * size, "fillstyle": "none", "color": rgb(_RECORDED), "alpha": 0.8}
    (circles,) = axis.plot(time, series.circles, "o", **ring)
    (line,) = axis.plot(time, series.line, "-", linewidth=1.3, color=color)
    (dots,) = axis.plot(time, series.dots, ".", markersize=4.4 * size, color=color)
    axis.set_ylabel(series.label, color=color, fontsize=11)
    axis.yaxis.set_label_coords(_LABEL_X, 0.5)
    axis.set_ylim(bottom, top)
    if not series.values.size:
        axis.set_yticks([])
        axis.text(0.5, 0.5, "no pose", ha="center", transform=axis.transAxes)
    return line, band, dots, circles


def _limits(series: Series) -> tuple[float, float]:
    if series.limits is not None:
        return series.limits
    values = series.values
    low, high = (float(values.min()), float(values.max())) if values.size else (0.0, 0.0)
    room = max(0.08 * (high - low), (_LEAST - (high - low)) / 2)
    return low - room, high + room


def _draw_status(axis: Any, time: Array, status: Array) -> None:
    """Draw a strip in the colour of each frame's status, with a legend above."""
    axis.set(yticks=[], ylim=(0, 1))
    axis.grid(False)
    axis.spines[:].set_visible(False)
    axis.set_ylabel("status", fontsize=11, rotation=0, ha="center", va="center")
    axis.yaxis.set_label_coords(_LABEL_X, 0.5)
    if not len(time):
        return
    last = time[-1] + (np.median(np.diff(time)) if len(time) > 1 else 0.1)
    ends = np.append(time[1:], last)
    names = set(status.tolist())
    colors = {name: color for name, color in STATUS_COLORS.items() if name in names}
    colors |= dict.fromkeys(sorted(names - colors.keys()), paint.FAINT)
    least = _LEAST_SHARE * (last - time[0])
    runs = []
    row = 0
    for name, frames in groupby(status.tolist()):
        start, row = row, row + len(list(frames))
        runs.append((max(ends[row - 1] - time[start], least), time[start], name))
    for width, start_time, name in sorted(runs, reverse=True):  # short ones on top of long ones
        axis.axvspan(start_time, start_time + width, color=rgb(colors[name]), linewidth=0)
    bars = {name: axis.bar(time[0], 0.0, 0.0, color=rgb(color)) for name, color in colors.items()}
    _explain(axis, bars, "left")


def _explain(axis: Any, shown: dict[str, Any], side: str) -> None:
    """A legend in one line above the panel, from its left or right end."""
    if shown:
        place: dict[str, Any] = {"loc": f"lower {side}", "bbox_to_anchor": (float(side == "right"), 1.1)}
        place |= {"borderaxespad": 0, "borderpad": 0, "handlelength": 1.4, "columnspacing": 1.6}
        axis.legend(shown.values(), shown, ncols=len(shown), **place)
