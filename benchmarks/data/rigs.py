"""Rigs, unlike the platform's, with which the tracker should work; they are given as data, with their scenes.

All scenes are on one stage, the simulated platform. A rig's world is the stage, moved and scaled: multiplying
all lengths in a world, including the distances of the cameras, by the same factor does not change the
images.
"""

import dataclasses
import functools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from benchmarks.data.plan import Plan, stream
from benchmarks.data.scenes import OBJECTS, Scene
from benchmarks.data.store import Store, each
from synthetic.camera.rigs import default_cameras, looking
from synthetic.camera.sensor import Sensor
from synthetic.scene import direction, drawn
from synthetic.stills import bare_scene, scene_with_fingers, take
from tracker.calibration.rig import CameraRig
from tracker.conventions import FloatArray
from tracker.geometry import so3
from tracker.geometry.arena import Arena
from tracker.geometry.camera import Camera
from tracker.objects.model import CuboidModel

_DISTORTION = np.array([-0.236, 0.115, -0.0014, 0.0002, -0.042])
"""Approximate distortion of the platform's lenses: k1, k2, p1, p2, k3."""

_LABELS = np.array([1, 5, 2, 6, 3, 4])
"""Face colours of the boxes defined here: those of cube_v2."""


@dataclass(frozen=True)
class Placement:
    """Pose and scale of the stage in a rig's world: p_world = scale · R_z(yaw) · p_stage + origin."""

    scale: float = 1.0
    """World length per stage length."""
    yaw: float = 0.0
    """[rad]"""
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """The stage's origin in the world [m]."""

    def pose(self, position: FloatArray, rotation: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return position (3,) [m] and rotation (3, 3), in the world, of an object on the stage."""
        turn = so3.exp([0.0, 0.0, self.yaw])
        return self.scale * turn @ position + self.origin, turn @ rotation

    def camera(self, camera: Camera) -> Camera:
        """Return the camera in the world that takes the same images as a camera on the stage."""
        position, rotation = self.pose(camera.position, camera.camera_from_world[:3, :3].T)
        camera_from_world = so3.transform(rotation.T, -rotation.T @ position)
        return dataclasses.replace(camera, camera_from_world=camera_from_world)


@dataclass(frozen=True, eq=False)
class RigCase:
    """Cameras around the stage, their objects, and the placement of the stage in the world."""

    name: str
    about: str
    """What is special about it, for tables."""
    stage_cameras: tuple[Camera, ...]
    """The cameras in the stage's frame."""
    models: tuple[CuboidModel, ...] = ()
    """The objects at world scale; empty: those of the other benchmarks."""
    arena: Arena = dataclasses.field(default_factory=Arena)
    """The arena in the world's frame."""
    placement: Placement = dataclasses.field(default_factory=Placement)

    @property
    def rig(self) -> CameraRig:
        """The rig given to the tracker: the true cameras in the world, and the arena."""
        return CameraRig(tuple(map(self.placement.camera, self.stage_cameras)), self.arena)

    @property
    def objects(self) -> tuple[CuboidModel, ...]:
        """The objects of this rig's scenes."""
        return self.models or tuple(drawn(name) for name in OBJECTS)

    def model(self, name: str) -> CuboidModel:
        """Return one of the objects by its name."""
        return next(model for model in self.objects if model.name == name)

    def on_stage(self, model: CuboidModel) -> CuboidModel:
        """Return an object at stage scale."""
        return dataclasses.replace(model, size=model.size / self.placement.scale)


def _camera(
    azimuth: float, elevation: float, distance: float, size: tuple[int, int], focal: float, lens: float = 1.0
) -> Camera:
    """Return a camera that looks roughly at the stage's centre, from a direction [°] and distance [m].

    Other parameters vary slightly from camera to camera, as on a real platform.

    `size` is the width and height of the image [px], `focal` the focal length [px], `lens` the strength of
    the distortion; 1 as on the platform.
    """
    rng = np.random.default_rng([int(azimuth), *size])
    position = distance * direction(*np.radians([azimuth, elevation]))
    target = np.add(rng.uniform(-0.006, 0.006, 3), (0.0, 0.0, 0.01))
    fx, fy = focal * rng.uniform(0.997, 1.003, 2)
    cx, cy = (np.array(size) - 1) / 2 + rng.uniform(-0.015, 0.015, 2) * min(size)
    return Camera(
        name=f"camera{azimuth:g}",
        width=size[0],
        height=size[1],
        matrix=np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]),
        distortion=lens * _DISTORTION * rng.uniform(0.97, 1.03, 5),
        camera_from_world=looking(position, target),
        camera_from_world_std=np.zeros((4, 4)),
    )


def _box(name: str, *size: float) -> CuboidModel:
    return CuboidModel(name, np.array(size), _LABELS, "cube_v2")


_PLATFORM = default_cameras()

# A distant camera has to look down steeply: below 60° the near wall hides part of the table.
_CASES = (
    RigCase("platform", "three 270×270, 0.52 m", _PLATFORM),
    RigCase(
        "long lens",
        "three 300×300, 2 m, fx 1180 px",
        tuple(_camera(azimuth, 60, 2.0, (300, 300), 1180) for azimuth in (60, 180, 300)),
    ),
    RigCase(
        "four 1280x1024",
        "four 1280×1024, 1 m, fx 1500 px",
        tuple(_camera(azimuth, 54, 1.0, (1280, 1024), 1500) for azimuth in (45, 135, 225, 315)),
    ),
    RigCase(
        "1080p",
        "three 1920×1080, 0.5 m, fx 1050 px",
        # The platform's distortion would fold back within such a wide image.
        tuple(_camera(azimuth, 49, 0.5, (1920, 1080), 1050, 0.45) for azimuth in (60, 180, 300)),
    ),
    RigCase(
        "mixed sizes",
        "270×270 at 0.52 m, 640×480 at 0.7 m, 1280×1024 at 1 m, 200×150 at 0.45 m",
        (
            _PLATFORM[0],
            _camera(150, 52, 0.7, (640, 480), 800),
            _camera(240, 54, 1.0, (1280, 1024), 1500),
            _camera(330, 55, 0.45, (200, 150), 150, 0.8),
        ),
    ),
    RigCase(
        "six cameras",
        "six 270×270, 0.52 to 0.6 m",
        (*_PLATFORM, *(_camera(azimuth, 58, 0.6, (270, 270), 330) for azimuth in (0, 120, 240))),
    ),
    RigCase("large box", "platform; a box of 100×60×40 mm", _PLATFORM, (_box("box_100", 0.1, 0.06, 0.04),)),
    RigCase(
        "small box",
        "three 270×270, 0.25 m, fx 460 px; a box of 12 mm in an arena of 6 cm",
        tuple(_camera(azimuth, 54, 0.25 / 0.3, (270, 270), 460) for azimuth in (60, 180, 300)),
        (_box("box_12", 0.012, 0.012, 0.012),),
        Arena(radius=0.06, height=0.05, table_std=(0.002, 0.017)),
        Placement(scale=0.3),
    ),
    RigCase(
        "origin elsewhere",
        "platform; the world's origin is 0.85 m away and the world turned by 40°",
        _PLATFORM,
        arena=Arena(center=(0.7, -0.4), table=0.25),
        placement=Placement(yaw=np.radians(40.0), origin=(0.7, -0.4, 0.25)),
    ),
    RigCase(
        "tall pixels",
        "platform; pixels 1.3 times as high as wide, 270×208",
        tuple(camera.resized(270, 208) for camera in _PLATFORM),
    ),
)

CASES = {case.name: case for case in _CASES}
"""All rigs, by name."""

NEAR = 0.2
"""Probability that each finger is near the object in odd scenes; even scenes have no fingers."""


def rig_scene(case: RigCase, model: CuboidModel, seed: int, index: int) -> Scene:
    """Return a scene of one of a rig's objects; all rigs get the same scene for a number and stage size."""
    on_stage = case.on_stage(model)
    rng = np.random.default_rng([seed, index])
    scene = scene_with_fingers(on_stage, rng, near=NEAR) if index % 2 else bare_scene(on_stage, rng)
    # Larger images need more noise draws, so the noise has its own stream.
    noise = np.random.default_rng([seed, index, 1])
    made = take(scene, case.stage_cameras, Sensor.realistic(), noise)
    pose = case.placement.pose(made.position, made.rotation)
    return Scene(tuple(made.images), made.visible_fraction, *pose, index=index, labels=tuple(made.labels))


def rig_store(case_name: str, object_name: str, plan: Plan) -> Store[Scene]:
    """Return the scenes of one of CASES and one of its objects, by number."""
    own = stream(plan.seed, "rigs")
    make = functools.partial(each, _scenes, case_name, object_name, own)
    return Store(f"{object_name}, rig, {case_name}", Scene, make, (__name__,), own, plan)


def _scenes(case_name: str, object_name: str, seed: int) -> Callable[[int], Scene]:
    case = CASES[case_name]
    return functools.partial(rig_scene, case, case.model(object_name), seed)
