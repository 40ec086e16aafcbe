"""Sets of scenes of an object, shared by workloads, with what the tracker needs for them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import tracker
from benchmarks.data.package.environment import interpreter
from benchmarks.data.package.scenes import Drawing, package_rig, package_store
from benchmarks.data.rigs import CASES, rig_store
from benchmarks.data.scenes import EFFECT, LARGE, LOOK_ALIKE, SIZE, Scene, rig, scene_store
from benchmarks.data.seeds import DEVELOPMENT
from benchmarks.data.store import CACHE, Store
from benchmarks.data.workloads import RIG
from synthetic.scene import drawn
from tracker.calibration.rig import CameraRig
from tracker.objects.model import CuboidModel
from tracker.segmentation.color_model import ColorModel

FULL = 200
"""Number of scenes per object in a full run."""

SHARES: Mapping[str, float] = {
    "realistic": 1.0,
    "world": 1.0,
    "absent": 0.5,
    "large": 0.1,
    "other cubes": 0.15,
    "package": 0.1,
    "smooth package": 0.1,
    "lens package": 0.1,
    LOOK_ALIKE: 0.1,
    EFFECT: 0.1,
    RIG: 0.02,
    "film": 0.5,
    "motion": 0.2,
    "thrown": 0.2,
    "laid": 0.1,
}
"""Size of each set relative to a full run, by its name or prefix: scenes, or frames of each film."""

RIMMED = "world", "absent", f"{EFFECT}chamfers"
"""Sets whose objects have rims, of the width in their files or another; other objects have sharp edges."""

PACKAGES = {
    "package": Drawing(),
    "smooth package": Drawing(scale=4),
    "lens package": Drawing(lens=True),
}
"""How the simulation package renders each set of scenes."""


@dataclass(frozen=True)
class Plan:
    """Which scenes are rendered, how many, and where they are cached."""

    scenes: int = FULL
    """Number of scenes of an object."""
    seed: int = DEVELOPMENT
    workers: int = 2
    """Number of processes that render."""
    cache: Path = CACHE
    """Folder of rendered scenes."""
    shares: Mapping[str, float] = field(default_factory=lambda: SHARES)
    """Size of each set relative to `scenes`."""

    def count(self, base: str) -> int:
        """Return the number of scenes of a set, or of frames of a film."""
        kind = base if base in self.shares else base[: base.index(": ") + 2]
        return max(1, round(self.shares[kind] * self.scenes))


@dataclass(frozen=True, eq=False)
class SceneSet:
    """The scenes of one set and object."""

    model: CuboidModel
    rig: CameraRig
    """The true cameras."""
    colors: ColorModel
    store: Store[Scene]
    numbers: Sequence[int]
    """Numbers of the scenes in the set."""

    def __iter__(self) -> Iterator[Scene]:
        """Yield all scenes, in order."""
        return self.store.scenes(self.numbers)

    def another(self, scene: Scene) -> Scene:
        """Return the neighbour of a scene in its stream."""
        return next(self.store.scenes([scene.index ^ 1]))


def scene_set(object_name: str, base: str, plan: Plan) -> SceneSet:
    """Return the scenes of a set and object.

    Args:
        object_name: name of the object.
        base: a style of `benchmarks.data.scenes`, a key of PACKAGES, or a rig's name after RIG.
        plan: their number and cache.

    Raises:
        PackageError: the simulation package is needed and not available.
    """
    keep, numbers = (plan.seed, plan.workers, plan.cache), range(plan.count(base))
    if base.startswith(RIG):
        case = CASES[base.removeprefix(RIG)]
        model = case.model(object_name)
        store = rig_store(case.name, object_name, *keep)
        return SceneSet(model, case.rig, tracker.load_colors(model.colors), store, numbers)
    model = tracker.load_object(object_name) if base in RIMMED else drawn(object_name)
    if base in PACKAGES:
        python = interpreter(plan.cache)
        store = package_store(object_name, PACKAGES[base], python, *keep)
        cameras = package_rig(python, PACKAGES[base])
        return SceneSet(model, cameras, tracker.load_colors("simulation"), store, numbers)
    store = scene_store(object_name, base, *keep)
    cameras = rig(LARGE if base == "large" else SIZE)
    return SceneSet(model, cameras, tracker.load_colors(model.colors), store, numbers)
