"""Films given to a tracker: what `update` said of each frame, against the truth."""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

import tracker
from benchmarks.data.films import FilmFrame
from benchmarks.measure.timing import reference_work
from benchmarks.score import errors as metrics
from tracker.conventions import Array, FloatArray
from tracker.geometry import so3

STILL_M, STILL_DEG = 1e-5, 0.01
"""An object that moved less since the frame before, and until the next one, is at rest [m], [°]."""

READ = 100
"""Frames that are read at once."""


@dataclass(frozen=True, eq=False)
class Played:
    """What `update` said of N frames, against the truth; nan where it said nothing, or there is none."""

    timestamp: FloatArray
    """(N,) [s]"""
    visible: FloatArray
    """(N, cameras)"""
    present: Array
    """(N,) whether there is an object."""
    measured: FloatArray
    """(N, 2) error of the measured pose [mm], [°]."""
    filtered: FloatArray
    """(N, 2) error of the filtered pose [mm], [°]."""
    given: Array
    """(N, 2) whether there was a measured, and a filtered pose."""
    confidence: FloatArray
    """(N,) of the filtered pose."""
    nees: FloatArray
    """(N,) of the filtered pose: squared error over its covariance, six degrees of freedom."""
    status: Array
    """(N,) names of `tracker.Status`."""
    times: FloatArray
    """(N, 2) of `update`, and of the reference work after it [ms]."""
    at_rest: Array
    """(N,) whether the object did not move since the frame before, nor until the next one."""

    def __len__(self) -> int:
        return len(self.timestamp)


def play(
    object_tracker: tracker.ObjectTracker, frames: Iterable[FilmFrame], camera: int | None = None
) -> Played:
    """Give a film to a tracker that begins anew, all cameras' pictures or those of one alone."""
    object_tracker.reset()
    rows: list[tuple[Any, ...]] = []
    poses: list[FloatArray] = []
    for frame in _read_ahead(frames):
        images = [
            image if camera is None or camera == number else None for number, image in enumerate(frame.images)
        ]
        start = time.perf_counter()
        said = object_tracker.update(images, frame.timestamp)
        middle = time.perf_counter()
        reference_work(images)
        times = 1e3 * (middle - start), 1e3 * (time.perf_counter() - middle)
        measured, filtered = said.object_pose, said.filtered_object_pose
        rows.append(
            (
                frame.timestamp,
                frame.visible_fraction,
                frame.position is not None,
                pose_error(measured, frame),
                pose_error(filtered, frame),
                (measured is not None, filtered is not None),
                np.nan if filtered is None else filtered.confidence,
                _nees(filtered, frame),
                said.status.name,
                times,
            )
        )
        poses.append(_true_pose(frame))
    columns = [np.array(column) for column in zip(*rows, strict=True)]
    columns.append(_at_rest(np.array(poses)))
    return Played(*columns)


def _read_ahead(frames: Iterable[FilmFrame]) -> Iterator[FilmFrame]:
    """The same, read from disk many at a time: what is timed follows upon its like, not upon unpacking."""
    rest = iter(frames)
    while block := list(itertools.islice(rest, READ)):
        yield from block


def _true_pose(frame: FilmFrame) -> FloatArray:
    if frame.position is None:
        return np.full((3, 4), np.nan)
    return np.column_stack([np.asarray(frame.rotation), frame.position])


def pose_error(pose: tracker.PoseEstimate | None, frame: FilmFrame) -> tuple[float, float]:
    """Distance [mm] and angle [°] of a pose from the truth; nan where one is missing."""
    if pose is None or frame.position is None or frame.rotation is None:
        return np.nan, np.nan
    shift = 1e3 * float(metrics.position_error(frame.position, pose.position))
    return shift, float(np.degrees(metrics.rotation_error(frame.rotation, pose.rotation)))


def _nees(pose: tracker.PoseEstimate | None, frame: FilmFrame) -> float:
    if pose is None or frame.position is None or frame.rotation is None:
        return np.nan
    true, found = (frame.position, frame.rotation), (pose.position, pose.rotation)
    return float(metrics.nees(true, found, pose.covariance))


def _at_rest(poses: FloatArray) -> Array:
    """(N,) of true poses (N, 3, 4); the first and the last frame are not known to be."""
    shift = np.linalg.norm(np.diff(poses[:, :, 3], axis=0), axis=1)
    turn = np.degrees(
        [so3.angle_between(a, b) for a, b in zip(poses[:-1, :, :3], poses[1:, :, :3], strict=True)]
    )
    still = (shift < STILL_M) & (turn < STILL_DEG)
    return np.asarray(np.r_[False, still] & np.r_[still, False])
