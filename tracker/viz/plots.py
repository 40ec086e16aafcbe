"""Plots by matplotlib, an optional package: dark like the other images, and written atomically.

One plot shows an object's face colours: their confusion matrix and chromaticities. The other shows a whole
recording: the object's pose, its uncertainty, and the tracker's status.
"""

from __future__ import annotations

import io
import os
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from tracker.checks import of_kind, optional, path_of
from tracker.conventions import Array, FloatArray
from tracker.errors import ImageError, TrackerError
from tracker.files import check_suffix, write_whole, writing
from tracker.geometry import so3
from tracker.objects.labels import COLOR_NAMES, DISPLAY_COLORS_BGR
from tracker.poses.columns import PoseColumns
from tracker.poses.poses import Poses
from tracker.summaries.summary import best
from tracker.viz import paint
from tracker.viz.overlays import DOUBTFUL, GOOD

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def rgb(color: Sequence[int]) -> tuple[float, float, float]:
    """Return red, green and blue from 0 to 1."""
    blue, green, red = color
    return red / 255, green / 255, blue / 255


_STYLE: Any = {
    **dict.fromkeys(("figure.facecolor", "savefig.facecolor", "axes.facecolor"), rgb(paint.BACKGROUND)),
    **dict.fromkeys(("text.color", "axes.labelcolor", "legend.labelcolor"), rgb(paint.FAINT)),
    **dict.fromkeys(("xtick.color", "ytick.color"), rgb(paint.FAINT)),
    **dict.fromkeys(("axes.edgecolor", "grid.color"), rgb((58, 51, 47))),
    **dict.fromkeys(("xtick.labelsize", "ytick.labelsize", "legend.fontsize"), 9),
    **dict.fromkeys(("xtick.major.size", "ytick.major.size"), 0),
    **dict.fromkeys(("axes.spines.top", "axes.spines.right", "axes.spines.left", "legend.frameon"), False),
    "axes.grid": True,
    "axes.axisbelow": True,
    "figure.dpi": 130,
    "savefig.dpi": 130,
    "text.parse_math": False,  # names of files may hold dollar signs, which begin formulas
}
"""Changes to matplotlib's default style: dark, with a faint grid and few lines."""


@contextmanager
def figure(size: tuple[float, float]) -> Iterator[Figure]:
    """Yield an empty figure of a given size [inch]; TrackerError if the package `matplotlib` is missing."""
    with warnings.catch_warnings(), optional("matplotlib", "plot", "a plot").rc_context(_STYLE):
        warnings.filterwarnings("ignore", "Glyph")  # a title may hold any character
        # Without pyplot, no display is needed and no figure stays in memory.
        yield optional("matplotlib.figure", "plot", "a plot").Figure(figsize=size, layout="constrained")


@contextmanager
def figure_file(path: str | os.PathLike[str], size: tuple[float, float]) -> Iterator[Figure]:
    """Like `figure`; at the end of the `with` block the figure is written as a PNG file, atomically."""
    target = path_of(path, "plot", ImageError)
    check_suffix(target, (".png",), "plot", ImageError)
    with figure(size) as drawn:
        yield drawn
        content = png(drawn)
    with writing(ImageError, f"plot {target}"):
        write_whole(target, content)


def png(drawn: Figure) -> bytes:
    """Return the figure as a PNG file."""
    content = io.BytesIO()
    drawn.savefig(content, format="png")
    return content.getvalue()


def write_colors_plot(
    path: str | os.PathLike[str],
    counts: Array,
    pixels: Mapping[int, Array],
    better: Mapping[int, FloatArray],
    title: str,
) -> None:
    """Write a PNG file with a confusion matrix and the chromaticities of the colours, atomically.

    Args:
        path: ends in .png.
        counts: numbers (7, 7) of pixels by true label and found label.
        pixels: BGR levels (N, 3) in neutral light, by label.
        better: BGR levels (3,) of a better set of colours, by label.
        title: the heading.

    Raises:
        ImageError: the suffix differs, or the file cannot be written.
        TrackerError: the optional package `matplotlib` is missing.
    """
    with figure_file(path, (12.0, 5.4)) as figure:
        figure.suptitle(title, color=rgb(paint.BRIGHT), fontsize=12)
        left, right = figure.subplots(1, 2, width_ratios=(1, 1.15))
        _draw_confusion(left, counts)
        _draw_colors(right, pixels, better)


def _draw_confusion(axis: Any, counts: Array) -> None:
    """Draw the share of each true colour's pixels by found label."""
    names = [*COLOR_NAMES[1:], "none"]
    sums = counts.sum(axis=1, keepdims=True)
    shares = np.roll(counts / np.maximum(sums, 1), -1, axis=(0, 1))  # "none", the first label, comes last
    axis.grid(False)
    axis.imshow(np.sqrt(shares), cmap="magma", vmin=0, vmax=1, aspect="auto")
    for (row, column), share in np.ndenumerate(shares):
        if share > 0:
            color = paint.BACKGROUND if share > 0.5 else paint.BRIGHT
            text = f"{100 * share:.0f}" if share >= 0.01 else "<1"
            axis.text(column, row, text, ha="center", va="center", fontsize=9, color=rgb(color))
    axis.set_xticks(range(len(names)), names)
    axis.set_yticks(range(len(names)), names)
    axis.set_xlabel("found as [% of the pixels]")
    axis.set_ylabel("is")


def _draw_colors(axis: Any, pixels: Mapping[int, Array], better: Mapping[int, FloatArray]) -> None:
    """Draw the colours' chromaticities relative to that of the light."""
    for label, some in pixels.items():
        color, few = rgb(DISPLAY_COLORS_BGR[label].tolist()), some[:: len(some) // 500 + 1]
        axis.plot(*_chroma(few), ".", markersize=3, alpha=0.35, color=color)
        middle = np.median(some, axis=0, keepdims=True)
        axis.plot(*_chroma(middle), "o", markersize=9, color=color, label=COLOR_NAMES[label])
        axis.plot(*_chroma(better[label][None]), "o", markersize=12, fillstyle="none", color=color)
    bright = rgb(paint.BRIGHT)
    axis.plot(0, 0, "+", markersize=14, color=bright)
    axis.annotate("light, grey", (0, 0), (6, 6), textcoords="offset points", color=bright, fontsize=9)
    axis.set_xlabel("log red / green  (rings: a better set)")
    axis.set_ylabel("log blue / green")


def _chroma(levels: Array) -> tuple[FloatArray, FloatArray]:
    """Return log(red/green) and log(blue/green) of levels (N, 3); dark colours are shifted towards grey."""
    logs = np.log(np.asarray(levels, dtype=np.float64) + 6.0)
    return logs[:, 2] - logs[:, 1], logs[:, 0] - logs[:, 1]


_AXES: dict[str, paint.Color] = {"x": (110, 120, 240), "y": (125, 205, 125), "z": (245, 165, 95)}
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
"""Colours of the status strip, the same in all plots."""

_LABEL_X = -0.065  # left of the longest tick label, so that the labels of all panels are aligned
_LEAST_SHARE = 0.003
"""Smallest share of the strip's width that a run of frames gets, so that single frames are visible."""

_LEAST = 2.0  # smallest range of an axis that is fitted to its values
_FEW = 250  # largest number of frames at which dots have their full size


def write_trajectory_plot(path: str | os.PathLike[str], poses: Poses, title: str = "") -> None:
    """Write a PNG file that plots position, rotation, confidence and status over time, atomically.

    Lines are filtered poses with a band of two standard deviations, dots are measured poses, circles are
    poses from the recording. If there are no filtered poses, lines are the measured ones. The rotation is
    the angle from the first pose.

    Args:
        path: ends in .png.
        poses: the poses to plot.
        title: the heading; by default the object and the source.

    Raises:
        ImageError: the suffix differs, or the file cannot be written.
        TrackerError: the optional package `matplotlib` is missing.
    """
    of_kind(poses, Poses, "plot: poses", TrackerError, "tracker.read_poses")
    of_kind(title, str, "plot: title", TrackerError)
    title = title or " · ".join(filter(None, (poses.about.object_name, poses.about.source)))
    with figure_file(path, (12.0, 10.0)) as figure:
        _draw_trajectory(figure, poses, title)


def _draw_trajectory(figure: Any, poses: Poses, title: str) -> None:
    time = poses.timestamp - poses.timestamp[:1]
    figure.get_layout_engine().set(h_pad=0.05, hspace=0.02, rect=(0.012, 0.012, 0.972, 0.974))
    axes = figure.subplots(6, 1, sharex=True, height_ratios=(0.32, 2, 2, 2, 2, 1.3))
    _draw_status(axes[0], time, poses.status)
    drawn, *_ = [_draw_panel(axis, time, one) for axis, one in zip(axes[1:], series_of(poses), strict=True)]
    axes[5].set_xlabel("time since the first frame [s]")
    if not len(poses):
        axes[0].set_xticks([])
    found = best(poses).has_pose
    share = f"{100 * np.mean(found):.1f} % of {len(poses)} frames have a pose" if len(poses) else "no frames"
    axes[0].set_title(title, loc="left", color=rgb(paint.BRIGHT), fontsize=14, pad=30)
    axes[0].set_title(share, loc="right", fontsize=10, pad=30)
    fused, recorded = bool(poses.filtered.has_pose.any()), poses.recorded is not None
    some, both = bool(found.any()), fused and bool(poses.measured.has_pose.any())
    names = ("filtered" if fused else "measured", f"±{_SIGMAS:g}σ", "measured", "recorded")
    there = zip(drawn, names, (some, some, both, recorded), strict=True)
    _explain(axes[1], {name: one for one, name, is_there in there if is_there}, "right")


class Series(NamedTuple):
    """The content of one panel for n frames; NaN where there is no value."""

    label: str
    color: paint.Color
    values: Array
    """Values (3, n) drawn as line, dots and circles."""
    band: FloatArray
    """Lower and upper ends (2, n) of a band around the line, which may be very wide."""
    limits: tuple[float, float]
    """Limits of the axis."""


def series_of(poses: Poses) -> list[Series]:
    """Return the panels; the axes of x, y and z span equal ranges, so that equal motions look equal."""
    recorded = PoseColumns.nothing(len(poses)) if poses.recorded is None else poses.recorded
    kinds = shown, _, _ = best(poses), poses.measured, recorded
    positions = 1e3 * np.stack([one.position for one in kinds])
    std = 1e3 * np.sqrt(np.diagonal(shown.covariance, axis1=1, axis2=2)[:, :3])
    limits = np.array([_limits(positions[:, :, k]) for k in range(3)])
    half = np.ptp(limits, axis=1).max() / 2
    result = []
    for k, (name, color) in enumerate(_AXES.items()):
        middle = limits[k].mean()
        values, band = positions[:, :, k], positions[0, :, k] + _SIGMAS * std[:, k] * [[-1], [1]]
        result.append(Series(f"{name} [mm]", color, values, band, (middle - half, middle + half)))
    posed = (one.orientation[np.argmax(one.has_pose)] for one in kinds if one.has_pose.any())
    first = so3.matrix_from_quaternion(next(posed, np.array([0.0, 0.0, 0.0, 1.0])))
    values = np.stack([angles(one.orientation, first) for one in kinds])
    spread = _SIGMAS * angle_std(shown.orientation, first, shown.covariance[:, 3:, 3:])
    band = np.stack([np.maximum(values[0] - spread, 0), np.minimum(values[0] + spread, 180)])
    result.append(Series("rotation [°]", (210, 140, 200), values, band, _limits(values)))
    values = np.stack([one.confidence for one in kinds])
    nothing = np.full((2, len(poses)), np.nan)
    highest = float(np.fmax.reduce(values, axis=None, initial=1.0))  # a recorder's may exceed 1
    return [*result, Series("confidence", paint.BRIGHT, values, nothing, (-0.04, highest + 0.04))]


def _limits(values: FloatArray) -> tuple[float, float]:
    """Return the limits of an axis that is fitted to the values."""
    known = values[np.isfinite(values)]
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 0.0)
    room = max(0.08 * (high - low), (_LEAST - (high - low)) / 2)
    return low - room, high + room


def angles(orientation: FloatArray, reference: FloatArray) -> FloatArray:
    """Return the angles (n,) [°] of quaternions (n, 4) from a rotation (3, 3); NaN for NaN quaternions."""
    return np.degrees(so3.angle_between(reference, so3.matrix_from_quaternion(orientation)))


def angle_std(orientation: FloatArray, reference: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return standard deviations (n,) [°] of `angles`, from covariances (n, 3, 3) [rad²] along world axes.

    With R = exp(δθ) R̂ the angle changes by axis · δθ, where axis is that of R̂ Rᵀ_reference. Near zero the
    axis is undefined, so the largest standard deviation over all axes is returned.
    """
    vector = so3.log(so3.matrix_from_quaternion(orientation) @ reference.T)
    length = np.linalg.norm(vector, axis=1)
    axis = vector / np.where(length > 0, length, 1)[:, None]
    along = np.einsum("ni,nij,nj->n", axis, covariance, axis)
    largest = np.linalg.eigvalsh(np.nan_to_num(covariance)).max(axis=1, initial=0)
    variance = np.where(length < 3 * np.sqrt(largest), largest, along)
    return np.asarray(np.degrees(np.sqrt(np.maximum(variance, 0))))


def _draw_panel(axis: Any, time: Array, series: Series) -> tuple[Any, ...]:
    """Draw a line with a band, dots and circles over time; return these four for a legend."""
    color = rgb(series.color)
    size = float(np.clip(np.sqrt(_FEW / max(len(time), 1)), 0.5, 1))
    band = axis.fill_between(time, *series.band, color=color, alpha=0.3, linewidth=0)
    ring = {"ms": 3.8 * size, "mew": 0.9 * size, "fillstyle": "none", "alpha": 0.8}
    (circles,) = axis.plot(time, series.values[2], "o", color=rgb((90, 215, 250)), **ring)
    (line,) = axis.plot(time, series.values[0], "-", linewidth=1.3, color=color)
    (dots,) = axis.plot(time, series.values[1], ".", markersize=4.4 * size, color=color)
    axis.set_ylabel(series.label, color=color, fontsize=11)
    axis.yaxis.set_label_coords(_LABEL_X, 0.5)
    axis.set_ylim(series.limits)
    if not np.isfinite(series.values).any():
        axis.set_yticks([])
        axis.text(0.5, 0.5, "no pose", ha="center", transform=axis.transAxes)
    return line, band, dots, circles


def _draw_status(axis: Any, time: Array, status: Array) -> None:
    """Draw a strip in the colour of each frame's status, with a legend above."""
    axis.set(yticks=[], ylim=(0, 1))
    axis.grid(False)
    axis.spines[:].set_visible(False)
    axis.set_ylabel("status", fontsize=11, rotation=0, ha="center", va="center")
    axis.yaxis.set_label_coords(_LABEL_X, 0.5)
    if not len(time):
        return
    last = time.max() + (np.median(np.diff(time)) if len(time) > 1 else 0.1)
    if last > time.min():
        axis.set_xlim(time.min(), last)
    names = set(status.tolist())
    colors = {name: color for name, color in STATUS_COLORS.items() if name in names}
    colors |= dict.fromkeys(sorted(names - colors.keys()), paint.FAINT)
    starts = np.flatnonzero(np.append(True, status[1:] != status[:-1]))
    lengths = np.diff(np.append(time[starts], last))
    widths = np.maximum(lengths, _LEAST_SHARE * (last - time[0]))
    for run in np.lexsort((starts, widths))[::-1]:  # short ones on top of long ones
        begin = min(time[starts[run]], last - widths[run])
        axis.axvspan(begin, begin + widths[run], color=rgb(colors[status[starts[run]]]), linewidth=0)
    bars = {name: axis.bar(time[0], 0.0, 0.0, color=rgb(color)) for name, color in colors.items()}
    _explain(axis, bars, "left")


def _explain(axis: Any, shown: dict[str, Any], side: str) -> None:
    """Draw a legend in one line above the panel, aligned to its left or right end."""
    if shown:
        place: dict[str, Any] = {"loc": f"lower {side}", "bbox_to_anchor": (float(side == "right"), 1.1)}
        place |= {"borderaxespad": 0, "borderpad": 0, "handlelength": 1.4, "columnspacing": 1.6}
        axis.legend(shown.values(), shown, ncols=len(shown), **place)
