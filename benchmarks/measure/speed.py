"""What a detection costs: by stage, number of cameras, resolution and faces in view, and at start-up."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

import tracker
from benchmarks.data.recorded import POSED
from benchmarks.data.sets import Plan
from benchmarks.measure.processes import process_rows
from benchmarks.measure.timed_scenes import (
    OBJECTS,
    TimedScene,
    platform_film,
    platform_scenes,
    recorded_scene,
    sized_scenes,
)
from benchmarks.measure.timing import Timings, time_detections, time_updates

SIZES = (270, 540, 1080)
"""Heights of square pictures [px]."""

RENDERED = "rendered"
RECORDED = "recorded"


ROUNDS, RECORDED_ROUNDS, FILM_ROUNDS = 10, 60, 5
"""Detections of each rendered scene, and of a recorded triplet; how often a film is played."""

LONGEST_FILM = 30
"""Frames of a film that is timed, at most."""

Rows = list[dict[str, Any]]


def measure_speed(plan: Plan, real: Path | None) -> Rows:
    """Rows of the parts `time…` and `start-up`.

    Times are wall-clock [ms] of one thread; `ratio` is the multiple of the reference work on the same images.

    Args:
        plan: says how many scenes.
        real: folder of recorded data, or None.
    """
    rows: Rows = []
    count = max(3, round(plan.scenes / 10))
    for name in OBJECTS:
        rig, scenes = platform_scenes(name, count)
        detector = tracker.ObjectTracker(tracker.load_object(name), rig)
        timings = time_detections(detector, scenes, ROUNDS)
        about = {"object": name, "group": _pictures(RENDERED, rig[0].height)}
        rows += _whole(about, timings)
        rows += [{"part": "time, cameras", **about, **row} for row in _by_cameras(detector, scenes)]
        rows += [{"part": "time, faces", **about, **row} for row in by_faces(scenes, timings)]
        rows.append({"part": "time, film", **about, **_film_row(name, min(LONGEST_FILM, 3 * count))})
        if name == OBJECTS[0]:
            rows += process_rows(name, rig, scenes[0], processes=min(7, count))
    for name in POSED if real is not None else ():
        assert real is not None
        detector, scene = recorded_scene(real, name)
        about = {"object": name, "group": _pictures(RECORDED, detector.rig[0].height)}
        rows += _whole(about, time_detections(detector, [scene], RECORDED_ROUNDS))
    return rows + [row for name in OBJECTS for row in _by_resolution(name, max(1, round(count / 5)))]


def _pictures(kind: str, size: int) -> str:
    return f"{kind}, {size}×{size}"


def _whole(about: dict[str, Any], timings: Timings) -> Rows:
    stages = [{"part": "time, stages", **about, **row} for row in timings.stage_rows()]
    return [{"part": "time", **about, **timings.row()}, *stages]


def _film_row(name: str, frames: int) -> dict[str, Any]:
    """`update` from frame to frame."""
    rig, film = platform_film(name, frames)
    return time_updates(tracker.ObjectTracker(tracker.load_object(name), rig), film, FILM_ROUNDS).row()


def _by_cameras(detector: tracker.ObjectTracker, scenes: Sequence[TimedScene]) -> Rows:
    """Scene k is seen by cameras k, k + 1, …, so that each camera has its turn."""
    rows = []
    total = len(detector.rig)
    for count in range(1, total + 1):
        seen = [scene.seen_by((k + c) % total for c in range(count)) for k, scene in enumerate(scenes)]
        rows.append({"bin": str(count), **time_detections(detector, seen, ROUNDS).row()})
    return rows


def _by_resolution(name: str, count: int) -> Rows:
    rows = []
    for size in SIZES:
        rig, scenes = sized_scenes(name, count, size)
        detector = tracker.ObjectTracker(tracker.load_object(name), rig)
        timings = time_detections(detector, scenes, ROUNDS)
        rows.append({"part": "time, resolution", "object": name, "bin": str(size), **timings.row()})
    return rows


def by_faces(scenes: Sequence[TimedScene], timings: Timings) -> Rows:
    """One row for each number of faces in view; `timings` hold equally many detections of each scene."""
    faces = np.repeat([scene.faces for scene in scenes], len(timings.detect) // len(scenes))
    rows = []
    for count in np.unique(faces):
        chosen = faces == count
        part = Timings(timings.detect[chosen], timings.reference[chosen], {}, timings.right[chosen])
        scenes_of = sum(scene.faces == int(count) for scene in scenes)
        rows.append({"bin": str(int(count)), "scenes": scenes_of, **part.row()})
    return rows
