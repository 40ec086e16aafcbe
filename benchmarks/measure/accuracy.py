"""Runs the workloads: what the tracker answers to every frame, beside the bound."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np

import tracker
from benchmarks.data.package.environment import PackageError
from benchmarks.data.scenes import OBJECTS
from benchmarks.data.store import CACHE
from benchmarks.data.workloads import (
    BY_NAME,
    FULL,
    PACKAGES,
    WORKLOADS,
    Case,
    SceneSet,
    Sizes,
    Workload,
    case,
)
from benchmarks.score import errors as metrics
from benchmarks.score.bound import bounds, scene_edges
from benchmarks.score.records import FrameRecord, select
from benchmarks.score.summary import summarise
from tracker.conventions import FloatArray
from tracker.pose.result import Observation

BINS_WORKLOAD = "occlusion bins"


@dataclass(frozen=True)
class AccuracyOptions:
    """What is run."""

    sizes: Sizes = FULL
    workloads: Sequence[Workload] = WORKLOADS
    objects: Sequence[str] = OBJECTS
    workers: int = 2
    """Processes that render."""
    cache: Path = CACHE
    """Folder of rendered scenes."""


@dataclass
class AccuracyRun:
    """The records of a run, and what was left out with the reason."""

    options: AccuracyOptions
    records: list[FrameRecord] = field(default_factory=list)
    skipped: dict[str, str] = field(default_factory=dict)

    def scene_set(self, object_name: str, base: str) -> SceneSet:
        """The scenes of one base set and object."""
        return SceneSet(object_name, base, self.options.sizes, self.options.workers, self.options.cache)

    def summary(self) -> dict[str, dict[str, dict[str, Any]]]:
        """Figures by workload and object; of the bins together with `realistic`, which they fill up."""
        result: dict[str, dict[str, dict[str, Any]]] = {}
        for workload in self.options.workloads:
            for name in self.options.objects:
                own = select(self.records, workload.name, name)
                if workload.name == BINS_WORKLOAD:
                    own = select(self.records, "realistic", name) + own
                if own:
                    result.setdefault(workload.name, {})[name] = summarise(own)
        return result


def measure_accuracy(
    options: AccuracyOptions | None = None, progress: Callable[[str], None] | None = None
) -> AccuracyRun:
    """Run all workloads; `progress` is told what comes next."""
    run = AccuracyRun(options or AccuracyOptions())
    options, threads = run.options, cv2.getNumThreads()
    # One thread, so that times compare; nothing else depends on it.
    cv2.setNumThreads(1)
    try:
        for name in options.objects:
            for base in dict.fromkeys(workload.base for workload in options.workloads):
                own = [workload for workload in options.workloads if workload.base == base]
                if progress:
                    progress(f"{name}: {', '.join(workload.name for workload in own)}")
                try:
                    scenes = run.scene_set(name, base)
                except PackageError as error:
                    run.skipped |= {workload.name: str(error) for workload in own}
                    continue
                run.records += _of_set(name, scenes, own)
    finally:
        cv2.setNumThreads(threads)
    places = {workload.name: k for k, workload in enumerate(options.workloads)}
    run.records.sort(key=lambda r: (places[r.workload], options.objects.index(r.object), r.index))
    return run


def _of_set(name: str, scenes: SceneSet, workloads: Sequence[Workload]) -> list[FrameRecord]:
    """Records of all workloads that share these scenes."""
    model = tracker.load_object(name)
    colors = scenes.colors or tracker.load_colors(model.colors)
    exact = tracker.ObjectTracker(model, scenes.rig, colors)
    records = []
    for count, scene in enumerate(scenes):
        if count == 0:
            exact.detect(scene.images)  # the first detection of a process loads or compiles kernels
        edges = None
        for workload in workloads:
            given = case(workload, name, scene, scenes.rig)
            detector = tracker.ObjectTracker(model, given.rig, colors) if workload.moved else exact
            record = compared(name, model, given, detector.detect(given.images))
            if record["present"]:
                edges = edges or scene_edges(given, model)
                record |= _bounds(given, edges)
            records.append(FrameRecord(**record))
    return records


def compared(name: str, model: tracker.CuboidModel, given: Case, answer: Observation) -> dict[str, Any]:
    """The fields of a record that say what was answered and how far it is from the truth."""
    scene, pose = given.scene, answer.object_pose
    record: dict[str, Any] = {
        "workload": given.workload.name,
        "object": name,
        "index": scene.index,
        "cameras": len(given.used),
        "visible_fraction": given.visible,
        "present": scene.position is not None,
        "status": answer.status.value,
        "found": pose is not None,
        "milliseconds": float(answer.timing_ms.get("total", np.nan)),
    }
    if pose is None:
        return record
    record["confidence"] = float(pose.confidence)
    if scene.position is None or scene.rotation is None:
        return record
    true, found = (scene.position, scene.rotation), (pose.position, pose.rotation)
    one, other = ((p[None], r[None]) for p, r in (true, found))
    mean, greatest = metrics.surface_error(model.size, one, other)
    task = metrics.task_errors(model.size, one, other)
    cameras = [given.true_rig[k] for k in given.used]
    record |= _position_and_rotation(true, found) | {
        "add_mm": 1e3 * float(mean[0]),
        "mssd_mm": 1e3 * float(greatest[0]),
        "mspd_px": float(metrics.image_error(model.size, cameras, one, other)[0]),
        "nees": float(metrics.nees(one, other, pose.covariance[None])[0]),
        "task_position_error": float(task[0][0]),
        "task_rotation_error": float(task[1][0]),
    }
    axis = metrics.longest_axis(model.size)
    if axis is not None:
        record["axis_deg"] = float(np.degrees(metrics.axis_error(true[1], found[1], axis)))
        record["roll_deg"] = float(np.degrees(metrics.roll_error(true[1], found[1], axis)))
    return record


def _position_and_rotation(
    true: tuple[FloatArray, FloatArray], found: tuple[FloatArray, FloatArray], prefix: str = ""
) -> dict[str, float]:
    return {
        f"{prefix}position_mm": 1e3 * float(metrics.position_error(true[0], found[0])),
        f"{prefix}rotation_deg": float(np.degrees(metrics.rotation_error(true[1], found[1]))),
    }


def _bounds(given: Case, edges: Any) -> dict[str, float]:
    position, rotation, fixed_position, fixed_rotation = bounds(given, edges)
    return {
        "bound_mm": 1e3 * position,
        "bound_deg": float(np.degrees(rotation)),
        "bound_fixed_mm": 1e3 * fixed_position,
        "bound_fixed_deg": float(np.degrees(fixed_rotation)),
    }


def again(run: AccuracyRun, record: FrameRecord) -> tuple[Case, Observation]:
    """What the tracker was given for a record, and its answer once more."""
    workload = BY_NAME[record.workload]
    scenes = run.scene_set(record.object, workload.base)
    model = tracker.load_object(record.object)
    (scene,) = scenes.scenes([record.index])
    given = case(workload, record.object, scene, scenes.rig)
    colors = scenes.colors or tracker.load_colors(model.colors)
    return given, tracker.ObjectTracker(model, given.rig, colors).detect(given.images)


def without_package(workloads: Sequence[Workload]) -> list[Workload]:
    """The workloads that need no environment of their own."""
    return [workload for workload in workloads if workload.base not in PACKAGES]
