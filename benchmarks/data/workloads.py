"""Named workloads: scenes, cameras, and disturbances of images and calibration.

Several workloads share the same scenes. The random draws of a workload depend only on the seed, the workload,
the object and the scene's number.
"""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.data import disturbances
from benchmarks.data.plan import EFFECT, LOOK_ALIKE, RIG, stream
from benchmarks.data.recorded import another
from benchmarks.data.rigs import CASES
from benchmarks.data.scenes import OBJECTS, STILL_EFFECTS, Scene
from synthetic.world.look_alikes import KINDS
from tracker.calibration.rig import CameraRig
from tracker.conventions import Image


@dataclass(frozen=True)
class Workload:
    """One way to measure the tracker."""

    name: str
    about: str
    """What is special about it, for tables."""
    base: str = "realistic"
    """Set of scenes, see `benchmarks.data.sets`."""
    disturb: disturbances.Disturbance | None = None
    cameras: int | None = None
    """Number of cameras used, in every combination in turn; None: all."""
    believed: Callable[[CameraRig, np.random.Generator], CameraRig] | None = None
    """Returns the calibration that the tracker gets instead of the true one."""
    objects: tuple[str, ...] = OBJECTS
    """Names of the objects."""
    other_moment: bool = False
    """Whether one camera's image shows another scene."""
    usual: bool = True
    """Whether it is measured by default."""


WORKLOADS = (
    Workload("realistic", "fingers, realistic cameras, exact calibration"),
    Workload("world", "realistic, with every effect of the real world, calibration errors too", "world"),
    Workload("absent", "as world, without an object", "absent"),
    Workload("two cameras", "realistic, each pair of cameras in turn", cameras=2),
    Workload("one camera", "realistic, each camera in turn", cameras=1),
    Workload(
        "perturbed calibration",
        "realistic, cameras off by 0.5 mm and 0.1° per axis",
        believed=disturbances.moved_rig,
    ),
    Workload("light", "realistic, gains ±20 % per channel, exposure 0.6-1.4", disturb=disturbances.light),
    Workload(
        "hard light",
        "realistic, gains 0.6-1.5, exposure 0.4-1.7, gamma 0.7-1.4, ramps ±35 %",
        disturb=disturbances.hard_light,
    ),
    Workload(
        "poor images", "realistic, blur σ 1.5 px, noise σ 16, JPEG 60", disturb=disturbances.poor_images
    ),
    Workload("JPEG", "realistic, JPEG 60 alone", disturb=disturbances.jpeg),
    Workload("flooded", "realistic, one camera dazzled", disturb=disturbances.flooded),
    Workload("black", "realistic, one camera black", disturb=disturbances.black),
    Workload("swapped", "realistic, two cameras mixed up", disturb=disturbances.swapped),
    Workload("other moment", "realistic, one camera of another scene", other_moment=True),
    Workload(
        "other calibration",
        "realistic, the calibration of another robot (recorded data)",
        believed=another,
    ),
    *(
        Workload(LOOK_ALIKE + kind, "realistic, but what is shown is not the object", LOOK_ALIKE + kind)
        for kind in KINDS
    ),
    Workload("540 px", "realistic, three 540×540", "large"),
    Workload("other cubes", "realistic, cube_v1 and cube_v3", "other cubes", objects=("cube_v1", "cube_v3")),
    *(
        Workload(EFFECT + name, f"realistic, with the effect {name} alone", EFFECT + name, usual=False)
        for name in STILL_EFFECTS
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
    Workload(
        "simulation package, light",
        "as it draws; gains ±20 % per channel, exposure 0.6-1.4",
        "package",
        disturb=disturbances.light,
    ),
    Workload(
        "simulation package, hard light",
        "as it draws; gains, exposure, gamma and ramps of hard light",
        "package",
        disturb=disturbances.hard_light,
    ),
    *(
        Workload(RIG + name, case.about, RIG + name, objects=tuple(model.name for model in case.objects))
        for name, case in CASES.items()
    ),
)
"""See `synthetic.world.look_alikes` and `synthetic.effects.NAMES` for those with these prefixes."""

BY_NAME = {workload.name: workload for workload in WORKLOADS}


@dataclass(frozen=True, eq=False)
class Case:
    """The tracker's input, and the ground truth."""

    workload: Workload
    scene: Scene
    images: list[Image | None]
    """One image per camera; None where the workload gives none."""
    rig: CameraRig
    """The rig that the tracker is given."""
    true_rig: CameraRig
    """The cameras that took the images."""

    @property
    def used(self) -> tuple[int, ...]:
        """Numbers of the cameras with an image."""
        return tuple(k for k, image in enumerate(self.images) if image is not None)

    @property
    def visible(self) -> float:
        """Mean visible fraction of the object over the used cameras."""
        return float(np.mean(self.scene.visible_fraction[list(self.used)]))


def case(
    workload: Workload,
    object_name: str,
    scene: Scene,
    usual: CameraRig,
    seed: int,
    other: Scene | None = None,
) -> Case:
    """Return a scene of the workload's set, taken by its `usual` rig, as changed by the workload.

    `other` is another scene, if the workload needs one.
    """
    rng = np.random.default_rng([stream(seed, "workload", workload.name, object_name), scene.index])
    true_rig, stated = scene.rigs(usual)
    images: Sequence[Image] = scene.images
    if workload.disturb is not None:
        images = workload.disturb(images, rng)
    if workload.other_moment:
        assert other is not None
        late = int(rng.integers(len(images)))
        images = [*images[:late], other.images[late], *images[late + 1 :]]
    count = len(images) if workload.cameras is None else workload.cameras
    choices = list(itertools.combinations(range(len(images)), count))
    used = choices[scene.index % len(choices)]
    return Case(
        workload,
        scene,
        [np.ascontiguousarray(image) if k in used else None for k, image in enumerate(images)],
        stated if workload.believed is None else workload.believed(stated, rng),
        true_rig,
    )
