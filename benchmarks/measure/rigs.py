"""What the tracker is worth before rigs unlike the platform's: other distances, pictures, boxes, worlds."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import tracker
from benchmarks.data.rig_cases import CASES, RigCase
from benchmarks.data.rig_scenes import DEVELOPMENT_SEED, RigScene, RigSceneStore
from benchmarks.data.store import CACHE
from benchmarks.measure.timing import RIGHT_DEG, RIGHT_MM, one_thread, reference_work
from benchmarks.score import errors as metrics
from benchmarks.score.summary import SURE, percent
from tracker.conventions import Array, FloatArray
from tracker.objects.model import CuboidModel

NEAR_MM, NEAR_DEG = 1.0, 1.0
"""A pose counts as near within these errors [mm], [°]."""


@dataclass(frozen=True)
class RigOptions:
    """How much is measured."""

    scenes: int = 12
    """For each rig and object."""
    seed: int = DEVELOPMENT_SEED
    """Of the scenes; `rig_scenes.SEED` for judging alone."""
    cases: tuple[str, ...] = tuple(CASES)
    """Names of the rigs."""
    workers: int = 2
    """Processes that render."""
    cache: Path = CACHE
    """Folder of rendered scenes."""


@dataclass(frozen=True)
class Answer:
    """What the tracker made of one scene; numbers of the pose are nan where there is none."""

    milliseconds: float
    """Time of the detection [ms]."""
    reference_ms: float
    """Time of the reference work on the same pictures [ms]."""
    visible: float
    """Mean visible fraction of the object over the cameras [1]."""
    position_mm: float = math.nan
    """Distance of the positions [mm]."""
    rotation_deg: float = math.nan
    """Angle of the rotation between the two [°]."""
    confidence: float = math.nan
    """Stated probability of being within 5 mm and 5° [1]."""


def measure_rigs(options: RigOptions, say: Callable[[str], None] = lambda line: None) -> dict[str, Any]:
    """Results as plain numbers: `about`, and `rows` with one row for each rig and object.

    Args:
        options: how much is measured.
        say: takes lines about the progress.
    """
    rows = []
    for name in options.cases:
        case = CASES[name]
        for model in case.objects:
            say(f"rigs, {name}, {model.name}")
            store = RigSceneStore(name, model.name, options.seed, options.workers, options.cache)
            numbers = range(options.scenes)
            store.prepare(numbers)
            answers = detect_all(case, model, store.scenes(numbers))
            rows.append({"rig": name, "object": model.name, **row(answers)})
    return {"about": {"seed": options.seed, "scenes": options.scenes}, "rows": rows}


def detect_all(case: RigCase, model: CuboidModel, scenes: Iterable[RigScene]) -> list[Answer]:
    """Detect in every scene once, in turn with the reference work; in the first once more, uncounted."""
    detector = tracker.ObjectTracker(model, case.rig)
    answers = []
    with one_thread():
        for count, scene in enumerate(scenes):
            if count == 0:
                detector.detect(scene.images)
                reference_work(scene.images)
            answers.append(_answer(detector, scene))
    return answers


def _answer(detector: tracker.ObjectTracker, scene: RigScene) -> Answer:
    start = time.perf_counter()
    pose = detector.detect(scene.images).object_pose
    middle = time.perf_counter()
    reference_work(scene.images)
    end = time.perf_counter()
    times = 1e3 * (middle - start), 1e3 * (end - middle), float(scene.visible_fraction.mean())
    if pose is None:
        return Answer(*times)
    return Answer(
        *times,
        position_mm=1e3 * float(metrics.position_error(scene.position, pose.position)),
        rotation_deg=float(np.degrees(metrics.rotation_error(scene.rotation, pose.rotation))),
        confidence=float(pose.confidence),
    )


def row(answers: Sequence[Answer]) -> dict[str, Any]:
    """Figures of one rig and object: shares of all scenes [%], medians of errors over the poses given."""
    errors = np.array([(answer.position_mm, answer.rotation_deg) for answer in answers])
    confidence = np.array([answer.confidence for answer in answers])
    spent = np.array([(answer.milliseconds, answer.reference_ms) for answer in answers])
    found = np.isfinite(errors).all(axis=1)
    right, near = _within(errors, RIGHT_MM, RIGHT_DEG), _within(errors, NEAR_MM, NEAR_DEG)
    middle = np.median(errors[found], axis=0) if found.any() else np.full(2, np.nan)
    return {
        "scenes": len(answers),
        "visible": percent(np.array([answer.visible for answer in answers])),
        "within_1": percent(near),
        "within_5": percent(right),
        "median_mm": float(middle[0]),
        "median_deg": float(middle[1]),
        "none": percent(~found),
        "wrong_and_sure": percent(found & ~right & (confidence > SURE)),
        "median_ms": float(np.median(spent[:, 0])),
        "ratio": float(np.median(spent[:, 0] / spent[:, 1])),
    }


def _within(errors: FloatArray, millimetres: float, degrees: float) -> Array:
    # Comparisons with nan are False.
    return np.asarray((errors <= (millimetres, degrees)).all(axis=1))
