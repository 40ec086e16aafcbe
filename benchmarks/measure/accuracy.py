"""Runs the workloads: collects `detect`'s answer to every scene, and its processor time."""

import contextlib
import functools
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
import pandas as pd

import tracker
from benchmarks.data.package.environment import PackageError
from benchmarks.data.plan import Plan
from benchmarks.data.recorded import another, robots
from benchmarks.data.sets import SceneSet, scene_set
from benchmarks.data.store import prepare
from benchmarks.data.workloads import Case, Workload, case
from benchmarks.measure.timing import one_thread, repeated
from benchmarks.score.errors import longest_axis, pose_errors, roll_error, true_pose
from tracker.conventions import Image
from tracker.errors import CalibrationError
from tracker.objects.model import CuboidModel
from tracker.pose.result import Observation

Made = tuple[list[dict[str, Any]], dict[str, str]]
"""Answers, and the workloads that were skipped, with reasons."""

Keep = Callable[[str, Callable[[], Made]], Made]
"""Returns the stored result with this name, or makes and stores it."""


def measure_accuracy(
    plan: Plan,
    workloads: Sequence[Workload],
    objects: Sequence[str] | None,
    keep: Keep = lambda name, make: make(),
) -> tuple[pd.DataFrame, dict[str, str]]:
    """Return one row per answer, by workload and object, and the reasons for skipped workloads.

    Of a workload's objects only those in `objects` are used; None: all. `keep` stores the answers to each set
    of scenes, so that an interrupted run can continue there.
    """
    answers: list[dict[str, Any]] = []
    skipped: dict[str, str] = {}
    pairs = ((name, workload.base) for workload in workloads for name in workload.objects)
    sets = dict.fromkeys((name, base) for name, base in pairs if objects is None or name in objects)
    needed = []
    for name, base in sets:
        # An unavailable package is reported later, when its scenes are measured.
        with contextlib.suppress(PackageError):
            scenes = scene_set(name, base, plan)
            needed.append((scenes.store, scenes.numbers))
    prepare(needed, plan.workers)
    for name, base in sets:
        own = [workload for workload in workloads if workload.base == base and name in workload.objects]
        made = keep(f"{name}, {base}", functools.partial(_of_set, plan, name, base, own))
        answers += made[0]
        skipped |= made[1]
    places = {workload.name: place for place, workload in enumerate(workloads)}
    names = list(dict.fromkeys(answer["object"] for answer in answers))
    answers.sort(key=lambda row: (places[row["group"]], names.index(row["object"]), row["index"]))
    return pd.DataFrame(answers), skipped


def _of_set(plan: Plan, name: str, base: str, workloads: Sequence[Workload]) -> Made:
    skipped: dict[str, str] = {}
    try:
        scenes = scene_set(name, base, plan)
    except PackageError as error:
        return [], {workload.name: str(error) for workload in workloads}
    try:
        robots()
    except CalibrationError as error:
        skipped = {workload.name: str(error) for workload in workloads if workload.believed is another}
    possible = [workload for workload in workloads if workload.name not in skipped]
    with one_thread():
        return list(_answers(scenes, possible, plan.seed)), skipped


def _answers(scenes: SceneSet, workloads: Sequence[Workload], seed: int) -> Iterator[dict[str, Any]]:
    """Yield the answers of all workloads that share these scenes."""
    model = scenes.model
    exact = tracker.ObjectTracker(model, scenes.rig, scenes.colors)
    for scene in scenes:
        for workload in workloads:
            other = scenes.another(scene) if workload.other_moment else None
            given = case(workload, model.name, scene, scenes.rig, seed, other)
            detector = exact
            if given.rig is not scenes.rig:
                detector = tracker.ObjectTracker(model, given.rig, scenes.colors)
            answer, times = repeated(functools.partial(detector.detect, given.images), given.images)
            yield answer_row(model, given, answer) | times


def answer_row(model: CuboidModel, given: Case, answer: Observation) -> dict[str, Any]:
    """Return a row with the answer to one scene, and its errors."""
    scene, pose = given.scene, answer.object_pose
    true = true_pose(scene.position, scene.rotation)
    row: dict[str, Any] = {
        "group": given.workload.name,
        "object": model.name,
        "index": scene.index,
        "pictures": signature(given.images),
        "visible": given.visible,
        "present": scene.position is not None,
        "status": answer.status.value,
        "found": pose is not None,
        "confidence": np.nan if pose is None else float(pose.confidence),
        "roll_deg": np.nan,
    }
    row |= pose_errors(pose, true)
    axis = longest_axis(model.size)
    if pose is not None and axis is not None and row["present"]:
        row["roll_deg"] = float(np.degrees(roll_error(true[:, :3], pose.rotation, axis)))
    stages = {key: spent for key, spent in answer.timing_ms.items() if key != "total"}
    return row | {f"{stage}_ms": spent for stage, spent in stages.items()}


def signature(images: Sequence[Image | None]) -> float:
    """Return a number that distinguishes images: a random projection of their pixels.

    Different noise changes it by about the noise's deviation, one level in one pixel by a thousandth.
    """
    total = 0.0
    for camera, image in enumerate(images):
        if image is not None:
            total += float(_weights(image.shape, camera).ravel() @ image.ravel()) / np.sqrt(image.size)
    return round(total, 4)


@functools.lru_cache(maxsize=16)
def _weights(shape: tuple[int, ...], camera: int) -> np.ndarray[Any, Any]:
    return np.random.default_rng(camera).choice(np.array([-1.0, 1.0], np.float32), shape)
