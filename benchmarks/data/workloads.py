"""Named workloads: which scenes, which cameras, what is done to pictures and calibration.

Several workloads share the same scenes. What is random in them depends on the seed, the workload and the
scene's number alone.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

import tracker
from benchmarks.data import disturbances
from benchmarks.data.package.scenes import Drawing, PackageStore
from benchmarks.data.scenes import OBJECTS, SEED, Scene, rig
from benchmarks.data.store import CACHE, SceneStore
from tracker.calibration.rig import CameraRig
from tracker.conventions import Image
from tracker.segmentation.color_model import ColorModel

BINS = ((0.9, 1.0), (0.7, 0.9), (0.5, 0.7), (0.3, 0.5))
"""Bins of the mean visible fraction; the lower end belongs to a bin, the upper only where it is 1."""


@dataclass(frozen=True)
class Sizes:
    """How many scenes of each set there are for an object."""

    realistic: int = 400
    clean: int = 100
    per_bin: int = 60
    """Least number in each bin of visible fractions, `realistic` included."""
    absent: int = 500
    package: int = 60


FULL = Sizes()
QUICK = Sizes(realistic=6, clean=3, per_bin=3, absent=6, package=3)


@dataclass(frozen=True)
class Workload:
    """One way to judge the tracker."""

    name: str
    about: str
    """What is special about it, for tables."""
    base: str = "realistic"
    """Set of scenes: realistic, clean, bins, absent or one of PACKAGES."""
    disturb: disturbances.Disturbance | None = None
    cameras: int = 3
    """With fewer than three each camera, or each pair of them, in turn."""
    moved: bool = False
    """Whether the tracker gets a calibration that is off by what it states."""
    stream: int = field(default=0)
    """Of random numbers."""


_WORKLOADS = (
    Workload("realistic", "fingers, realistic cameras, exact calibration"),
    Workload("clean", "neither blur nor noise, mosaic or differences between cameras", "clean"),
    Workload("occlusion bins", "realistic, chosen to fill every bin of visible fractions", "bins"),
    Workload("absent", "realistic, without an object", "absent"),
    Workload("two cameras", "realistic, each pair of cameras in turn", cameras=2),
    Workload("one camera", "realistic, each camera in turn", cameras=1),
    Workload("perturbed calibration", "realistic, cameras off by 0.5 mm and 0.1° per axis", moved=True),
    Workload("light", "realistic, gains ±20 % per channel, exposure 0.6-1.4", disturb=disturbances.light),
    Workload(
        "hard light",
        "realistic, gains 0.6-1.5, exposure 0.4-1.7, gamma 0.7-1.4, ramps ±35 %",
        disturb=disturbances.hard_light,
    ),
    Workload(
        "poor images", "realistic, blur σ 1.5 px, noise σ 16, JPEG 60", disturb=disturbances.poor_images
    ),
    Workload("simulation package", "the platform's simulation package, as it draws", "package"),
    Workload("simulation package, smooth", "the same, 4×4 points per pixel", "smooth package"),
    Workload(
        "simulation package, disturbed",
        "the smooth one, blur σ 0.3-0.8 px, gains ±7 % per channel, noise σ 3",
        "smooth package",
        disturb=disturbances.slightly_poor,
    ),
    Workload(
        "simulation package, lens",
        "as it draws, bent by the lens, and the cameras' stated deviations believed",
        "lens package",
    ),
    Workload(
        "simulation package, lens, blurred",
        "the same, blur σ 0.5 px",
        "lens package",
        disturb=disturbances.slight_blur,
    ),
)
WORKLOADS = tuple(dataclasses.replace(w, stream=k) for k, w in enumerate(_WORKLOADS))
"""The workloads; new ones come last, since a workload's random numbers depend on its place."""

BY_NAME = {workload.name: workload for workload in WORKLOADS}

PACKAGES = {
    "package": Drawing(),
    "smooth package": Drawing(scale=4),
    "lens package": Drawing(lens=True),
}
"""How the simulation package draws, by set of scenes."""


@dataclass(frozen=True, eq=False)
class Case:
    """What the tracker is given, and the truth."""

    workload: Workload
    scene: Scene
    images: list[Image | None]
    """One of each camera; None where the workload gives none."""
    rig: CameraRig
    """What the tracker believes."""
    true_rig: CameraRig
    """The cameras that took the pictures."""

    @property
    def used(self) -> tuple[int, ...]:
        """Numbers of the cameras that give an image."""
        return tuple(k for k, image in enumerate(self.images) if image is not None)

    @property
    def visible(self) -> float:
        """Mean visible fraction of the object over the cameras used."""
        return float(np.mean(self.scene.visible_fraction[list(self.used)]))


def case(workload: Workload, object_name: str, scene: Scene, true_rig: CameraRig) -> Case:
    """The scene as the workload shows it."""
    rng = np.random.default_rng([SEED, workload.stream, OBJECTS.index(object_name), scene.index])
    images: Sequence[Image] = scene.images
    if workload.disturb is not None:
        images = workload.disturb(images, rng)
    choices = list(itertools.combinations(range(len(images)), min(workload.cameras, len(images))))
    used = choices[scene.index % len(choices)]
    return Case(
        workload,
        scene,
        [np.ascontiguousarray(image) if k in used else None for k, image in enumerate(images)],
        disturbances.moved_rig(true_rig, rng) if workload.moved else true_rig,
        true_rig,
    )


def bin_of(visible: float) -> int | None:
    """Index into BINS; None below all of them."""
    for k, (low, high) in enumerate(BINS):
        if low <= visible and (visible < high or high == 1.0):
            return k
    return None


class SceneSet:
    """The scenes of one base set and object.

    Args:
        object_name: name of the object.
        base: see `Workload.base`.
        sizes: numbers of scenes.
        workers: processes that render.
        folder: cache of rendered scenes.

    Raises:
        PackageError: the simulation package is needed and cannot be had.
    """

    def __init__(
        self, object_name: str, base: str, sizes: Sizes, workers: int = 2, folder: Path = CACHE
    ) -> None:
        self._name, self._sizes, self._workers, self._folder = object_name, sizes, workers, folder
        self.rig = rig()
        self.colors: ColorModel | None = None
        self.indices: Sequence[int]
        self._store: SceneStore | PackageStore
        if base in PACKAGES:
            store = PackageStore(object_name, PACKAGES[base], sizes.package, folder)
            self.rig, self.colors = store.rig, tracker.load_colors("simulation")
            self._store, self.indices = store, range(sizes.package)
        elif base == "bins":
            self._store = self._stored("more")
            self.indices = self._filling()
        else:
            self._store = self._stored(base)
            self.indices = range(int(getattr(sizes, base)))

    def _stored(self, style: str) -> SceneStore:
        return SceneStore(self._name, style, self._workers, self._folder)

    def __iter__(self) -> Iterator[Scene]:
        """All scenes, in order."""
        return self._store.scenes(self.indices)

    def scenes(self, indices: Sequence[int]) -> Iterator[Scene]:
        """The scenes of these numbers."""
        return self._store.scenes(indices)

    def _filling(self) -> list[int]:
        """Numbers of the scenes that fill up the bins which `realistic` leaves short.

        Chosen by sketches of the scenes, in order; whether a finished scene stays in the sketch's bin is
        left to chance, so each bin gets a few more than are asked for.
        """
        counts = [0] * len(BINS)
        for scene in self._stored("realistic").scenes(range(self._sizes.realistic)):
            found = bin_of(scene.visible)
            if found is not None:
                counts[found] += 1
        wanted = self._sizes.per_bin + round(0.03 * self._sizes.per_bin)
        sketches = self._stored("sketch")
        chosen: list[int] = []
        for first in itertools.count(0, BATCH):
            if min(counts) >= wanted or first >= MAX_SKETCHES:
                return chosen
            for scene in sketches.scenes(range(first, first + BATCH)):
                found = bin_of(scene.visible)
                if found is not None and counts[found] < wanted:
                    counts[found] += 1
                    chosen.append(scene.index)
        return chosen


BATCH = 24
"""Scenes that are sketched at a time."""

MAX_SKETCHES = 2400
"""After so many sketches a bin stays short."""
