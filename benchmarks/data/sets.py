"""Sets of scenes: the scenes of an object that workloads share, with what the tracker needs for them."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import tracker
from benchmarks.data.package.environment import interpreter
from benchmarks.data.package.scenes import Drawing, package_rig, package_store
from benchmarks.data.rig_cases import CASES
from benchmarks.data.rig_scenes import rig_store
from benchmarks.data.scenes import LARGE, SIZE, Scene, rig, scene_store
from benchmarks.data.seeds import DEVELOPMENT
from benchmarks.data.store import CACHE, Store
from benchmarks.data.workloads import RIG
from tracker.calibration.rig import CameraRig
from tracker.objects.model import CuboidModel
from tracker.segmentation.color_model import ColorModel

FULL = 400
"""Realistic scenes of an object in a full run; of everything else there are so many in proportion."""

SHARES = {"realistic": 1.0, "clean": 0.25, "absent": 1.25, "package": 0.15, "rig": 0.03, "bins": 0.15}
"""Scenes of a set over the realistic ones; of the bins those in each bin."""

OTHERS = 0.25
"""The same of all other sets."""

BINS = ((0.9, 1.0), (0.7, 0.9), (0.5, 0.7), (0.3, 0.5))
"""Bins of the mean visible fraction; the lower end belongs to a bin, the upper only where it is 1."""

PACKAGES = {
    "package": Drawing(),
    "smooth package": Drawing(scale=4),
    "lens package": Drawing(lens=True),
}
"""How the simulation package draws, by set of scenes."""

BATCH = 24
"""Scenes that are sketched at a time."""

MAX_SKETCHES = 2400
"""After so many sketches a bin stays short."""


@dataclass(frozen=True)
class Plan:
    """Which scenes, how many, and where they are kept."""

    scenes: int = FULL
    """Realistic ones of an object."""
    seed: int = DEVELOPMENT
    workers: int = 2
    """Processes that render."""
    cache: Path = CACHE
    """Folder of rendered scenes."""

    def count(self, kind: str) -> int:
        """Number of scenes of a set."""
        return max(min(self.scenes, 3), round(SHARES.get(kind, OTHERS) * self.scenes))


@dataclass(frozen=True, eq=False)
class SceneSet:
    """The scenes of one set and object."""

    model: CuboidModel
    rig: CameraRig
    """The true cameras."""
    colors: ColorModel
    store: Store[Scene]
    numbers: Sequence[int]
    """Of the scenes that belong to the set."""

    def __iter__(self) -> Iterator[Scene]:
        """All scenes, in order."""
        return self.store.scenes(self.numbers)

    def another(self, scene: Scene) -> Scene:
        """The scene beside one in its stream."""
        return next(self.store.scenes([scene.index ^ 1]))


def scene_set(object_name: str, base: str, plan: Plan) -> SceneSet:
    """The scenes of a set and object.

    Args:
        object_name: name of the object.
        base: a style of `benchmarks.data.scenes`, `bins`, a key of PACKAGES, or a rig's name after RIG.
        plan: how many, and where they are kept.

    Raises:
        PackageError: the simulation package is needed and cannot be had.
    """
    keep = (plan.seed, plan.workers, plan.cache)
    if base.startswith(RIG):
        case = CASES[base.removeprefix(RIG)]
        model = case.model(object_name)
        colors = tracker.load_colors(model.colors)
        store = rig_store(case.name, object_name, *keep)
        return SceneSet(model, case.rig, colors, store, range(plan.count("rig")))
    model = tracker.load_object(object_name)
    if base in PACKAGES:
        python, colors = interpreter(plan.cache), tracker.load_colors("simulation")
        store = package_store(object_name, PACKAGES[base], python, *keep)
        cameras = package_rig(python, PACKAGES[base])
        return SceneSet(model, cameras, colors, store, range(plan.count("package")))
    colors = tracker.load_colors(model.colors)
    store = scene_store(object_name, "more" if base == "bins" else base, *keep)
    numbers = _filling(object_name, plan) if base == "bins" else range(plan.count(base))
    return SceneSet(model, rig(LARGE if base == "large" else SIZE), colors, store, numbers)


def bin_of(visible: float) -> int | None:
    """Index into BINS; None below all of them."""
    for k, (low, high) in enumerate(BINS):
        if low <= visible and (visible < high or high == 1.0):
            return k
    return None


def _filling(object_name: str, plan: Plan) -> list[int]:
    """Numbers of the scenes that fill up the bins which the realistic ones leave short.

    Chosen by sketches of the scenes, in order; whether a finished scene stays in the sketch's bin is left to
    chance, so each bin gets a few more than are asked for.
    """
    counts = [0] * len(BINS)
    for scene in scene_set(object_name, "realistic", plan):
        found = bin_of(scene.visible)
        if found is not None:
            counts[found] += 1
    wanted = round(1.03 * plan.count("bins"))
    sketches = scene_store(object_name, "sketch", plan.seed, plan.workers, plan.cache)
    chosen: list[int] = []
    for first in itertools.count(0, BATCH):
        if min(counts) >= wanted or first >= MAX_SKETCHES:
            return chosen
        for scene in sketches.scenes(range(first, first + BATCH)):
            found = bin_of(scene.visible)
            if found is not None and counts[found] < wanted:
                counts[found] += 1
                chosen.append(scene.index)
    raise AssertionError
