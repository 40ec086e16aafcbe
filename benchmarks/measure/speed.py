"""What a detection costs: by stage, number of cameras, resolution and faces in view, and at start-up."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import tracker
from benchmarks.measure.processes import process_rows
from benchmarks.measure.recorded import POSED
from benchmarks.measure.timed_scenes import (
    OBJECTS,
    TimedScene,
    platform_scenes,
    raycast_scenes,
    recorded_scene,
)
from benchmarks.measure.timing import Timings, time_detections

SIZES = (270, 540, 1080)
"""Heights of square pictures [px]."""

RENDERED = "rendered"
RECORDED = "recorded"

Rows = list[dict[str, Any]]


@dataclass(frozen=True)
class SpeedOptions:
    """How much is measured."""

    scenes: int = 40
    """Rendered scenes of an object."""
    rounds: int = 10
    """Detections of each."""
    sized_scenes: int = 8
    """Ray-cast scenes of an object at each resolution."""
    recorded_rounds: int = 60
    """Detections of a recorded triplet."""
    processes: int = 7
    """Fresh processes for start-up and memory."""


QUICK = SpeedOptions(scenes=3, rounds=4, sized_scenes=1, recorded_rounds=5, processes=1)


def measure_speed(real: Path | None, options: SpeedOptions | None = None) -> dict[str, Rows]:
    """Rows of figures by table: `detect`, `stages`, `cameras`, `resolution`, `faces`, `process`.

    Times are wall-clock [ms] of one thread; `ratio` is the multiple of the reference work on the same
    images. Only `process` differs: `what`, `value`, `unit`.

    Args:
        real: folder of recorded data, or None.
        options: how much is measured.
    """
    options = options or SpeedOptions()
    tables: dict[str, Rows] = {"detect": [], "stages": [], "cameras": [], "resolution": [], "faces": []}
    for name in OBJECTS:
        rig, scenes = platform_scenes(name, options.scenes)
        detector = tracker.ObjectTracker(tracker.load_object(name), rig)
        about = {"images": RENDERED, "object": name, "size": rig[0].height, "scenes": len(scenes)}
        timings = time_detections(detector, scenes, options.rounds)
        tables["detect"].append({**about, **timings.row()})
        tables["stages"] += [{**about, **row} for row in timings.stage_rows()]
        tables["cameras"] += [{**about, **row} for row in _by_cameras(detector, scenes, options.rounds)]
        tables["faces"] += [{"object": name, **row} for row in by_faces(scenes, timings)]
        if name == OBJECTS[0]:
            tables["process"] = process_rows(name, rig, scenes[0], options.processes)
    for name in POSED if real is not None else ():
        assert real is not None
        detector, scene = recorded_scene(real, name)
        about = {"images": RECORDED, "object": name, "size": detector.rig[0].height, "scenes": 1}
        timings = time_detections(detector, [scene], options.recorded_rounds)
        tables["detect"].append({**about, **timings.row()})
        tables["stages"] += [{**about, **row} for row in timings.stage_rows()]
    for name in OBJECTS:
        tables["resolution"] += _by_resolution(name, options)
    return tables


def _by_cameras(detector: tracker.ObjectTracker, scenes: Sequence[TimedScene], rounds: int) -> Rows:
    """Scene k is seen by cameras k, k + 1, …, so that each camera has its turn."""
    rows = []
    total = len(detector.rig)
    for count in range(1, total + 1):
        seen = [scene.seen_by((k + c) % total for c in range(count)) for k, scene in enumerate(scenes)]
        rows.append({"cameras": count, **time_detections(detector, seen, rounds).row()})
    return rows


def _by_resolution(name: str, options: SpeedOptions) -> Rows:
    rows = []
    for size in SIZES:
        rig, scenes = raycast_scenes(name, options.sized_scenes, size)
        detector = tracker.ObjectTracker(tracker.load_object(name), rig)
        timings = time_detections(detector, scenes, options.rounds)
        rows.append({"object": name, "size": size, "scenes": len(scenes), **timings.row()})
    return rows


def by_faces(scenes: Sequence[TimedScene], timings: Timings) -> Rows:
    """One row for each number of faces in view; `timings` hold equally many detections of each scene."""
    faces = np.repeat([scene.faces for scene in scenes], len(timings.detect) // len(scenes))
    rows = []
    for count in np.unique(faces):
        chosen = faces == count
        part = Timings(timings.detect[chosen], timings.reference[chosen], {}, timings.right[chosen])
        scenes_of = sum(scene.faces == int(count) for scene in scenes)
        rows.append({"faces": int(count), "scenes": scenes_of, **part.row()})
    return rows
