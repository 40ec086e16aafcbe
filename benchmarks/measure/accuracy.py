"""Runs the workloads: what the tracker answers to every frame, beside the bound."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd

import tracker
from benchmarks.data.package.environment import PackageError
from benchmarks.data.robots import another, robots
from benchmarks.data.sets import Plan, SceneSet, scene_set
from benchmarks.data.workloads import BY_NAME, WORKLOADS, Case, Workload, case
from benchmarks.measure.timing import in_turn, one_thread
from benchmarks.score import errors
from benchmarks.score.bound import bounds, scene_edges
from benchmarks.score.records import FrameRecord, frame_of
from tracker.errors import CalibrationError
from tracker.objects.model import CuboidModel
from tracker.pose.result import Observation


@dataclass
class AccuracyRun:
    """What was answered, and what was left out with the reason."""

    plan: Plan
    frames: pd.DataFrame = field(default_factory=lambda: frame_of([]))
    """A row for each `FrameRecord`."""
    skipped: dict[str, str] = field(default_factory=dict)
    """Reasons by workload."""


def measure_accuracy(
    plan: Plan,
    say: Callable[[str], None] = lambda line: None,
    workloads: Sequence[Workload] = WORKLOADS,
    objects: Sequence[str] | None = None,
) -> AccuracyRun:
    """Run workloads.

    Args:
        plan: which scenes.
        say: takes lines about the progress.
        workloads: to be run.
        objects: to be looked at, of those that a workload has; None: all.
    """
    run, records = AccuracyRun(plan), []
    sets = dict.fromkeys((name, workload.base) for workload in workloads for name in workload.objects)
    with one_thread():
        for name, base in sets:
            if objects is not None and name not in objects:
                continue
            own = [workload for workload in workloads if workload.base == base and name in workload.objects]
            say(f"{name}: {', '.join(workload.name for workload in own)}")
            try:
                scenes = scene_set(name, base, plan)
                own = _possible(own, run.skipped)
            except PackageError as error:
                run.skipped |= {workload.name: str(error) for workload in own}
                continue
            records += _of_set(scenes, own, plan.seed)
    places = {workload.name: place for place, workload in enumerate(workloads)}
    names = list(dict.fromkeys(record.object for record in records))
    records.sort(key=lambda record: (places[record.workload], names.index(record.object), record.index))
    run.frames = frame_of(records)
    return run


def _possible(workloads: Sequence[Workload], skipped: dict[str, str]) -> list[Workload]:
    """Those for which everything is there; of the others the reason goes into `skipped`."""
    possible = list(workloads)
    for workload in workloads:
        if workload.believed is another:
            try:
                robots()
            except CalibrationError as error:
                skipped[workload.name] = str(error)
                possible.remove(workload)
    return possible


def _of_set(scenes: SceneSet, workloads: Sequence[Workload], seed: int) -> list[FrameRecord]:
    """Records of all workloads that share these scenes."""
    model = scenes.model
    exact = tracker.ObjectTracker(model, scenes.rig, scenes.colors)
    records = []
    for count, scene in enumerate(scenes):
        if count == 0:
            exact.detect(scene.images)  # the first detection of a process loads or compiles kernels
        edges = None
        for workload in workloads:
            other = scenes.another(scene) if workload.other_moment else None
            given = case(workload, model.name, scene, scenes.rig, seed, other)
            detector = exact
            if given.rig is not scenes.rig:
                detector = tracker.ObjectTracker(model, given.rig, scenes.colors)
            answer, _, reference = in_turn(functools.partial(detector.detect, given.images), given.images)
            record = compared(model, given, answer) | {"reference_ms": reference}
            if record["present"] and workload.bounded:
                edges = edges or scene_edges(given, model)
                record |= _bounds(given, edges)
            records.append(FrameRecord(**record))
    return records


def compared(model: CuboidModel, given: Case, answer: Observation) -> dict[str, Any]:
    """The fields of a record that say what was answered and how far it is from the truth."""
    scene, pose = given.scene, answer.object_pose
    record: dict[str, Any] = {
        "workload": given.workload.name,
        "object": model.name,
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
    mean, greatest = errors.surface_error(model.size, one, other)
    task = errors.task_errors(model.size, one, other)
    cameras = [given.true_rig[k] for k in given.used]
    record |= {
        "position_mm": 1e3 * float(errors.position_error(true[0], found[0])),
        "rotation_deg": float(np.degrees(errors.rotation_error(true[1], found[1]))),
        "add_mm": 1e3 * float(mean[0]),
        "mssd_mm": 1e3 * float(greatest[0]),
        "mspd_px": float(errors.image_error(model.size, cameras, one, other)[0]),
        "nees": float(errors.nees(one, other, pose.covariance[None])[0]),
        "task_position_error": float(task[0][0]),
        "task_rotation_error": float(task[1][0]),
    }
    axis = errors.longest_axis(model.size)
    if axis is not None:
        record["axis_deg"] = float(np.degrees(errors.axis_error(true[1], found[1], axis)))
        record["roll_deg"] = float(np.degrees(errors.roll_error(true[1], found[1], axis)))
    return record


def _bounds(given: Case, edges: Any) -> dict[str, float]:
    position, rotation, fixed_position, fixed_rotation = bounds(given, edges)
    return {
        "bound_mm": 1e3 * position,
        "bound_deg": float(np.degrees(rotation)),
        "bound_fixed_mm": 1e3 * fixed_position,
        "bound_fixed_deg": float(np.degrees(fixed_rotation)),
    }


def again(plan: Plan, record: pd.Series) -> tuple[Case, CuboidModel, Observation]:
    """What the tracker was given for a row of the frames, of what object, and its answer once more."""
    workload = BY_NAME[record.workload]
    scenes = scene_set(record.object, workload.base, plan)
    (scene,) = scenes.store.scenes([int(record["index"])])
    given = case(workload, record.object, scene, scenes.rig, plan.seed, scenes.another(scene))
    detector = tracker.ObjectTracker(scenes.model, given.rig, scenes.colors)
    return given, scenes.model, detector.detect(given.images)
