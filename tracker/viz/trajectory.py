"""Where the object was over a whole recording, how sure that is, and what the tracker was doing."""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator
from typing import Any

import numpy as np

from tracker.conventions import FloatArray
from tracker.geometry import so3
from tracker.poses.columns import MeasuredColumns, PoseColumns
from tracker.poses.poses import Poses
from tracker.viz import paint
from tracker.viz.figure import figure_for, write_figure
from tracker.viz.plots import Series, draw_legend, draw_panel, draw_status, mark, patch, rgb, style

SIZE = (12.0, 10.0)
"""Width and height of the picture [inch]."""

_AXES: dict[str, paint.Color] = {"x": (110, 120, 240), "y": (125, 205, 125), "z": (245, 165, 95)}
_ROTATION: paint.Color = (210, 140, 200)
_RECORDED: paint.Color = (90, 215, 250)
_SIGMAS = 2.0


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
    figure = figure_for(path, SIZE)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph")  # a title may hold any character
        _draw(figure, poses, title or " · ".join(filter(None, (poses.about.object_name, poses.about.source))))
        write_figure(path, figure)


def _draw(figure: Any, poses: Poses, title: str) -> None:
    time = poses.timestamp - poses.timestamp[:1]
    figure.get_layout_engine().set(h_pad=0.05, hspace=0.02, rect=(0.012, 0.012, 0.972, 0.974))
    axes = figure.subplots(6, 1, sharex=True, height_ratios=(0.32, 2, 2, 2, 2, 1.3))
    for axis in axes:
        style(axis)
    draw_status(axes[0], time, poses.status)
    for axis, series in zip(axes[1:], _series(poses), strict=True):
        draw_panel(axis, time, series)
    axes[5].set_xlabel("time since the first frame [s]", color=rgb(paint.FAINT), fontsize=10)
    if len(poses) > 1 and time.max() > time.min():
        axes[0].set_xlim(time.min(), time.max())
    elif not len(poses):
        axes[0].set_xticks([])
    found = _best(poses).has_pose
    share = f"{np.mean(found):.1%} of {len(poses)} frames have a pose" if len(poses) else "no frames"
    # A dollar sign in the name of a file begins no formula.
    heading = title.replace("$", r"\$")
    axes[0].set_title(heading, loc="left", color=rgb(paint.BRIGHT), fontsize=14, pad=30)
    axes[0].set_title(share, loc="right", color=rgb(paint.FAINT), fontsize=10, pad=30)
    _explain(axes[1], poses)


def _best(poses: Poses) -> MeasuredColumns:
    """The poses that are shown as lines."""
    return poses.filtered if poses.filtered.has_pose.any() else poses.measured


def _series(poses: Poses) -> Iterator[Series]:
    """One panel after the other."""
    best, measured = _best(poses), poses.measured
    recorded = PoseColumns.nothing(len(poses)) if poses.recorded is None else poses.recorded
    for k, (name, color) in enumerate(_AXES.items()):
        line, dots, circles = (1e3 * columns.position[:, k] for columns in (best, measured, recorded))
        band = 1e3 * _SIGMAS * np.sqrt(best.covariance[:, k, k])
        yield Series(f"{name} [mm]", color, line, line - band, line + band, dots, circles, _RECORDED)
    first = _first_rotation(best, measured, recorded)
    line, dots, circles = (angles(columns.orientation, first) for columns in (best, measured, recorded))
    band = _SIGMAS * angle_std(best.orientation, first, best.covariance[:, 3:, 3:])
    low, high = np.maximum(line - band, 0), np.minimum(line + band, 180)
    yield Series("rotation [°]", _ROTATION, line, low, high, dots, circles, _RECORDED)
    nothing = np.full(len(poses), np.nan)
    line, dots, circles = (columns.confidence for columns in (best, measured, recorded))
    limits = (-0.04, 1.04)
    yield Series("confidence", paint.BRIGHT, line, nothing, nothing, dots, circles, _RECORDED, limits)


def _first_rotation(*kinds: PoseColumns) -> FloatArray:
    """(3, 3) of the first frame that has a pose of the first kind that has any."""
    for columns in kinds:
        if columns.has_pose.any():
            return so3.matrix_from_quaternion(columns.orientation[np.argmax(columns.has_pose)])
    return np.eye(3)


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


def _explain(axis: Any, poses: Poses) -> None:
    """What line, band, dots and circles are."""
    fused = bool(poses.filtered.has_pose.any())
    handles: list[Any] = []
    if _best(poses).has_pose.any():
        handles.append(mark(paint.BRIGHT, "filtered" if fused else "measured", "-"))
        handles.append(patch(paint.BRIGHT, f"±{_SIGMAS:g}σ", 0.3))
    if fused and poses.measured.has_pose.any():
        handles.append(mark(paint.BRIGHT, "measured", "."))
    if poses.recorded is not None:
        handles.append(mark(_RECORDED, "recorded", "o"))
    if handles:
        draw_legend(axis, handles, (1, 1.02), "lower right")
