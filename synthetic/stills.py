"""Stills: images that cameras of any kind take of one scene of the platform, and the ground truth.

They leave out what the frames of `synthetic.frames` add (a robot's recordings, effects, sizes). They need no
OpenGL and, without fingers, no PyBullet.
"""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from synthetic.camera.lens import Lens
from synthetic.camera.sensor import Sensor
from synthetic.look.appearance import random_lighting, random_look
from synthetic.render.renderer import render
from synthetic.scene import PlatformScene
from synthetic.world.placement import CUBOID_KINDS
from synthetic.world.platform import Platform
from synthetic.world.scenes import random_scene
from tracker.conventions import Array, FloatArray, Image
from tracker.geometry.camera import Camera
from tracker.objects.model import CuboidModel

POINTS = 2
"""Points per pixel along each axis."""

_LAID = {kind: share for kind, share in CUBOID_KINDS.items() if kind != "thrown"}
"""Kinds of scene that need no physics, with their probabilities."""


@dataclass(frozen=True, eq=False)
class Still:
    """Images of a scene, one per camera, and the ground truth."""

    scene: PlatformScene
    images: list[Image]
    """(H, W, 3) uint8, BGR."""
    labels: list[Image]
    """(H, W) uint8 label map, by majority in each pixel; 0 for non-objects."""
    visible_fraction: FloatArray
    """(cameras,) share of the object's pixels that nothing else hides; 0 where there are none."""

    @property
    def position(self) -> FloatArray:
        """(3,) the object's centre [m], for scenes with one object."""
        return self.scene.objects[0].position

    @property
    def rotation(self) -> FloatArray:
        """(3, 3) world_from_object, for scenes with one object."""
        return self.scene.objects[0].rotation


def take(
    scene: PlatformScene,
    cameras: Sequence[Camera],
    sensor: Sensor,
    rng: np.random.Generator,
    *,
    points: int = POINTS,
    shadows: bool = False,
) -> Still:
    """Take images of `scene` with all cameras. `rng` draws the sensor's noise and gains, and nothing else."""
    images, labels, fractions = [], [], []
    for camera in cameras:
        lens = Lens(camera, points)
        view = dataclasses.replace(lens.view, block=points)
        layers = render(scene, view, shadows=shadows)
        images.append(sensor.expose(lens.to_camera(layers.color, "mean"), rng))
        labels.append(np.asarray(lens.to_camera(layers.labels, "label"), dtype=np.uint8))
        alone = lens.to_camera(layers.alone, "label")
        fractions.append(int(np.count_nonzero(labels[-1])) / max(int(np.count_nonzero(alone)), 1))
    return Still(scene, images, labels, np.array(fractions))


def bare_scene(
    model: CuboidModel, rng: np.random.Generator, *, kind: str | None = None, object_present: bool = True
) -> PlatformScene:
    """Draw a scene without the robot; `kind` is "rest", "tilted", "air", or drawn as well."""
    shares = np.array(list(_LAID.values()))
    kind = kind or str(rng.choice(list(_LAID), p=shares / shares.sum()))
    return random_scene(Platform(model), rng, near=None, kind=kind, object_present=object_present)


def posed_scene(
    model: CuboidModel, pose: tuple[Array, Array] | None, rng: np.random.Generator
) -> PlatformScene:
    """Return a scene without the robot, whose colours and light are drawn.

    The object is at `pose`, a position (3,) [m] and a rotation (3, 3); None: there is none.
    """
    platform = Platform(model)
    look, lighting = random_look(rng, model), random_lighting(rng)
    states = () if pose is None else platform.object_states(pose[0][None], pose[1][None])
    return platform.scene(states, None, look, lighting, {})


def scene_with_fingers(model: CuboidModel, rng: np.random.Generator, *, near: float = 0.5) -> PlatformScene:
    """Draw a scene in which each finger is near the object with the probability `near`."""
    with Platform(model) as platform:
        return random_scene(platform, rng, near=near)
