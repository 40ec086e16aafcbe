"""Time of a detection, as a multiple of reference work in the same process."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

import tracker
from benchmarks.recorded import POSED, triplet
from synthetic.raycast import render
from synthetic.sensor import Sensor
from synthetic.simple import random_scene
from synthetic.simple_rig import default_cameras
from tracker.conventions import Image


def reference_work(images: list[Image]) -> None:
    """Median blur 5 and conversion to HSV of every image: what the segmentation of old began with."""
    for image in images:
        cv2.cvtColor(cv2.medianBlur(image, 5), cv2.COLOR_BGR2HSV)


def paired(
    work: Callable[[], object], reference: Callable[[], object], rounds: int
) -> tuple[float, float, float]:
    """Median seconds of both, taken in turn, and the median of their ratios."""
    times = np.empty((rounds, 2))
    for row in times:
        for k, call in enumerate((work, reference)):
            start = time.perf_counter()
            call()
            row[k] = time.perf_counter() - start
    ratio = float(np.median(times[:, 0] / times[:, 1]))
    return float(np.median(times[:, 0])), float(np.median(times[:, 1])), ratio


def speed_table(real: Path | None, scenes: int = 20, rounds: int = 40) -> str:
    """One thread, warm; recorded triplets, and the median over rendered scenes with fingers."""
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    rows = ["| images | detection | reference work | ratio |", "|---|---|---|---|"]
    try:
        if real is not None:
            for name in POSED:
                detector, labelled = triplet(real, name, corrected=False)
                images = [i.image for i in labelled]
                detector.detect(images)
                timed = paired(
                    lambda d=detector, i=images: d.detect(i), lambda i=images: reference_work(i), rounds
                )
                size = images[0].shape[0]
                rows.append(_row(f"{name}, recorded, {size}×{size}", *timed))
        rig = tracker.CameraRig(default_cameras())
        for name in ("cube_v2", "cuboid_2x2x8_v2"):
            model = tracker.load_object(name)
            detector = tracker.ObjectTracker(model, rig)
            results = []
            for k in range(scenes):
                rng = np.random.default_rng([31, k])
                images = render(random_scene(model, rng), rig.cameras, model, Sensor.realistic(), rng).images
                detector.detect(images)
                results.append(
                    paired(lambda d=detector, i=images: d.detect(i), lambda i=images: reference_work(i), 7)
                )
            median = np.median(results, axis=0)
            rows.append(_row(f"{name}, {scenes} rendered scenes with fingers, 270×270", *median))
    finally:
        cv2.setNumThreads(threads)
    return "\n".join(rows)


def _row(title: str, seconds: float, reference: float, ratio: float) -> str:
    return f"| {title} | {1e3 * seconds:.2f} ms | {1e3 * reference:.2f} ms | {ratio:.2f} |"
