"""How long detections take, next to reference work on the same images in the same process."""

from __future__ import annotations

import contextlib
import functools
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar

import cv2
import numpy as np

import tracker
from benchmarks.measure.timed_scenes import TimedScene
from benchmarks.score.shares import RIGHT_DEG, RIGHT_MM, median, percent, quantile
from tracker.conventions import FloatArray, Image
from tracker.geometry import so3

OTHER = "other"
"""Stage of what the tracker's own stages leave of the whole."""


@dataclass(frozen=True, eq=False)
class Timings:
    """Wall-clock times of N detections, or updates, [ms], and what they found."""

    detect: FloatArray
    """(N,) of the detections."""
    reference: FloatArray
    """(N,) of the reference work that followed each."""
    stages: dict[str, FloatArray]
    """(N,) for each stage that the tracker names, and `OTHER`."""
    right: FloatArray
    """(N,) 1 where the pose was within 5 mm and 5°, 0 where it was not, NaN where the truth is unknown."""

    def row(self) -> dict[str, Any]:
        """Median and p99 [ms], multiples of the reference work, and the share of right answers [%]."""
        ratio = self.detect / self.reference
        return {
            "n": len(self.detect),
            "median_ms": median(self.detect),
            "p99_ms": quantile(self.detect, 0.99),
            "reference_ms": median(self.reference),
            "ratio": median(ratio),
            "ratio_p99": quantile(ratio, 0.99),
            "right": percent(self.right[np.isfinite(self.right)]),
        }

    def stage_rows(self) -> list[dict[str, Any]]:
        """One row for each stage: median and p99 [ms], and the median as a multiple of the reference work."""
        return [
            {
                "bin": name,
                "n": len(times),
                "median_ms": median(times),
                "p99_ms": quantile(times, 0.99),
                "ratio": median(times / self.reference),
            }
            for name, times in self.stages.items()
        ]


@contextlib.contextmanager
def one_thread() -> Iterator[None]:
    """OpenCV uses one thread meanwhile; nothing else of the tracker uses more."""
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(threads)


def reference_work(images: Sequence[Image | None]) -> None:
    """Median blur 5 and conversion to HSV of every image: what the segmentation of old began with."""
    for image in images:
        if image is not None:
            cv2.cvtColor(cv2.medianBlur(image, 5), cv2.COLOR_BGR2HSV)


T = TypeVar("T")


def in_turn(work: Callable[[], T], images: Sequence[Image | None]) -> tuple[T, float, float]:
    """What some work gives, its time, and that of the reference work on the same images after it [ms]."""
    start = time.perf_counter()
    result = work()
    middle = time.perf_counter()
    reference_work(images)
    return result, 1e3 * (middle - start), 1e3 * (time.perf_counter() - middle)


def time_detections(detector: tracker.ObjectTracker, scenes: Sequence[TimedScene], rounds: int) -> Timings:
    """Detect in every scene `rounds` times, in turn with the reference work, after once uncounted."""
    rows = []
    with one_thread():
        for scene in scenes:
            detector.detect(scene.images)
            reference_work(scene.images)
            work = functools.partial(detector.detect, scene.images)
            rows += [_timed(work, scene) for _ in range(rounds)]
    return _timings(rows)


def time_updates(follower: tracker.ObjectTracker, film: Sequence[TimedScene], rounds: int) -> Timings:
    """Play a film from its start `rounds` times, in turn with the reference work, after once uncounted.

    What counts are the frames in which the object is followed from the frame before.
    """
    rows = []
    with one_thread():
        for number in range(rounds + 1):
            follower.reset()
            played = [
                _timed(functools.partial(follower.update, scene.images, scene.timestamp), scene)
                for scene in film
            ]
            rows += [row for row in played if number and row.status is tracker.Status.TRACKING]
    return _timings(rows)


class _Row(NamedTuple):
    detect: float
    reference: float
    stages: dict[str, float]
    right: float
    status: tracker.Status


def _timed(work: Callable[[], tracker.Observation], scene: TimedScene) -> _Row:
    observation, own, reference = in_turn(work, scene.images)
    stages = {stage: spent for stage, spent in observation.timing_ms.items() if stage != "total"}
    right = _right(observation.object_pose, scene)
    return _Row(own, reference, stages, right, observation.status)


def _timings(rows: Sequence[_Row]) -> Timings:
    detect = np.array([row.detect for row in rows])
    reference, right = (np.array([getattr(row, name) for row in rows]) for name in ("reference", "right"))
    return Timings(detect, reference, _by_stage([row.stages for row in rows], detect), right)


def _by_stage(rows: Sequence[dict[str, float]], whole: FloatArray) -> dict[str, FloatArray]:
    """A stage that a detection did not reach took no time there."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    stages = {name: np.array([row.get(name, 0.0) for row in rows]) for name in names}
    stages[OTHER] = np.maximum(whole - sum(stages.values(), np.zeros(len(whole))), 0.0)
    return stages


def _right(pose: tracker.PoseEstimate | None, scene: TimedScene) -> float:
    if scene.position is None or scene.rotation is None:
        return np.nan
    if pose is None:
        return 0.0
    shift = 1e3 * np.linalg.norm(pose.position - scene.position)
    turn = np.degrees(so3.angle_between(pose.rotation, scene.rotation))
    return float(shift < RIGHT_MM and turn < RIGHT_DEG)
