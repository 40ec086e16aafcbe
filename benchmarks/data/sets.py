"""Sets of scenes of an object, shared by workloads, with what the tracker needs for them."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import tracker
from benchmarks.data.package.environment import interpreter
from benchmarks.data.package.scenes import Drawing, package_rig, package_store
from benchmarks.data.plan import EFFECT, RIG, Plan
from benchmarks.data.rigs import CASES, rig_store
from benchmarks.data.scenes import LARGE, SIZE, Scene, rig, scene_store
from benchmarks.data.store import Store
from synthetic.scene import drawn
from tracker.calibration.rig import CameraRig
from tracker.objects.model import CuboidModel
from tracker.segmentation.color_model import ColorModel

RIMMED = "world", "absent", f"{EFFECT}chamfers"
"""Sets whose objects have rims, of the width in their files or another; other objects have sharp edges."""

PACKAGES = {
    "package": Drawing(),
    "smooth package": Drawing(scale=4),
    "lens package": Drawing(lens=True),
}
"""How the simulation package renders each set of scenes."""


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

    `base` is a style of `benchmarks.data.scenes`, a key of PACKAGES, or a rig's name after RIG.

    Raises:
        PackageError: the simulation package is needed and not available.
    """
    if base.startswith(RIG):
        case = CASES[base.removeprefix(RIG)]
        model, cameras = case.model(object_name), case.rig
        colors, store = model.colors, rig_store(case.name, object_name, plan)
    elif base in PACKAGES:
        python = interpreter(plan.cache)
        model, cameras = drawn(object_name), package_rig(python, PACKAGES[base])
        colors, store = "simulation", package_store(object_name, PACKAGES[base], python, plan)
    else:
        model = tracker.load_object(object_name) if base in RIMMED else drawn(object_name)
        cameras = rig(LARGE if base == "large" else SIZE)
        colors, store = model.colors, scene_store(object_name, base, plan)
    return SceneSet(model, cameras, tracker.load_colors(colors), store, range(plan.count(base)))
