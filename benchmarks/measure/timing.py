"""How long detections take, next to reference work on the same images in the same process."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

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
    """Wall-clock times of N detections [ms], and what they found."""

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


def time_detections(detector: tracker.ObjectTracker, scenes: Sequence[TimedScene], rounds: int) -> Timings:
    """Detect in every scene `rounds` times, in turn with the reference work, after once uncounted."""
    detect, reference, right = [], [], []
    stages: list[dict[str, float]] = []
    with one_thread():
        for scene in scenes:
            detector.detect(scene.images)
            reference_work(scene.images)
            for _ in range(rounds):
                start = time.perf_counter()
                observation = detector.detect(scene.images)
                middle = time.perf_counter()
                reference_work(scene.images)
                reference.append(1e3 * (time.perf_counter() - middle))
                detect.append(1e3 * (middle - start))
                stages.append({k: v for k, v in observation.timing_ms.items() if k != "total"})
                right.append(_right(observation.object_pose, scene))
    return Timings(
        np.array(detect), np.array(reference), _by_stage(stages, np.array(detect)), np.array(right)
    )


def _by_stage(rows: list[dict[str, float]], whole: FloatArray) -> dict[str, FloatArray]:
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
