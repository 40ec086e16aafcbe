"""Benchmark scenes: images and ground truth.

Each style has its own stream of scenes. A scene depends only on seed, object, style and number.
"""

import dataclasses
import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.data.plan import EFFECT, LOOK_ALIKE, Plan, stream
from benchmarks.data.store import Store, each
from synthetic.camera.rigs import sized, standard_rig
from synthetic.effects import NAMES as EFFECTS
from synthetic.frames import Frame, FrameMaker, FrameOptions
from synthetic.world.look_alikes import KINDS
from tracker.calibration.rig import CameraRig
from tracker.conventions import Array, FloatArray, Image

SIZE = 270
"""Height of the images [px]."""

LARGE = 540
"""Height of the images of the style `large` [px]."""

OBJECTS = ("cube_v2", "cuboid_2x2x8_v2")

STILL_EFFECTS = tuple(name for name in EFFECTS if name != "timing")
"""Effects that are visible in scenes without motion."""


@dataclass(frozen=True, eq=False)
class Moment:
    """One image of each camera, and the ground truth."""

    images: tuple[Image, ...]
    """(H, W, 3) uint8 BGR."""
    visible_fraction: FloatArray
    """(cameras,) visible share of the object's pixels."""
    position: FloatArray | None
    """(3,) position of the object [m]; None: no object."""
    rotation: FloatArray | None
    """(3, 3) world_from_object."""
    cameras: Array | None = None
    """(2, cameras) of CAMERA, the true and the stated ones; None: both are those of the set."""

    def rigs(self, usual: CameraRig) -> tuple[CameraRig, CameraRig]:
        """Return the true rig, and the stated one, which is given to a user; `usual` is the set's rig."""
        if self.cameras is None:
            return usual, usual
        rigs = []
        for rows in self.cameras:
            parts = [{name: row[name] for name in rows.dtype.names} for row in rows]
            cameras = [dataclasses.replace(one, **part) for one, part in zip(usual, parts, strict=True)]
            rigs.append(dataclasses.replace(usual, cameras=tuple(cameras)))
        return rigs[0], rigs[1]


@dataclass(frozen=True, eq=False, kw_only=True)
class Scene(Moment):
    """A moment without a past, and what each pixel shows."""

    index: int
    """Number of the scene in its stream."""
    labels: tuple[Image, ...]
    """(H, W) uint8 label map, by majority in each pixel: 0 other, 1 red ... 6 yellow."""


def rig(size: int = SIZE) -> CameraRig:
    """Return the true cameras of all styles, for images of height `size` [px]."""
    return sized(standard_rig(), size)


def scene_store(object_name: str, style: str, plan: Plan) -> Store[Scene]:
    """Return the scenes of an object in a style of STYLES, by number."""
    own = stream(plan.seed, "scenes", object_name, style)
    make = functools.partial(each, STYLES[style], object_name, own)
    return Store(f"{object_name}, {style}", Scene, make, (__name__,), own, plan)


def _frames(object_name: str, seed: int, **options: Any) -> Callable[[int], Scene]:
    frames = FrameMaker(FrameOptions(object_name, seed, **({"size": SIZE, "empty": 0.0} | options)))

    def make(index: int) -> Scene:
        (frame,) = frames.chunk(index)
        return Scene(**vars(moment_of(frame)), index=frame.index, labels=frame.labels)

    return make


def moment_of(frame: Frame) -> Moment:
    """Return what a rendered frame shows."""
    position = rotation = cameras = None
    if frame.objects:
        position, rotation = np.array(frame.objects[0].position), np.array(frame.objects[0].rotation)
    if frame.given is not frame.rig:
        cameras = np.stack([rows_of(frame.rig), rows_of(frame.given)])
    return Moment(frame.images, frame.visible_fraction, position, rotation, cameras)


CAMERA = np.dtype(
    [
        ("matrix", np.float64, (3, 3)),
        ("distortion", np.float64, (5,)),
        ("camera_from_world", np.float64, (4, 4)),
        ("camera_from_world_std", np.float64, (4, 4)),
    ]
)
"""A camera's parameters by name, in an array."""


def rows_of(rig: CameraRig) -> Array:
    """Return the rig's cameras as an array (cameras,) of CAMERA."""
    rows = np.zeros(len(rig), CAMERA)
    for row, camera in zip(rows, rig, strict=True):
        for name in CAMERA.names or ():
            if (value := getattr(camera, name)) is not None:
                row[name] = value
    return rows


STYLES: dict[str, Callable[[str, int], Callable[[int], Scene]]] = {
    "realistic": _frames,
    "world": functools.partial(_frames, effects=STILL_EFFECTS),
    "absent": functools.partial(_frames, effects=STILL_EFFECTS, empty=1.0),
    "large": functools.partial(_frames, size=LARGE),
    "other cubes": _frames,
    **{EFFECT + name: functools.partial(_frames, effects=(name,)) for name in STILL_EFFECTS},
    **{LOOK_ALIKE + kind: functools.partial(_frames, look_alike=kind) for kind in KINDS},
}
"""realistic: as `synthetic.frames` makes them, always with an object.
world, effect: …: realistic, with all effects of the real world that stills show, or with one alone.
absent: like world, without an object.
large: realistic, 540 px high.
other cubes: realistic, of cube_v1 and cube_v3.
look-alike: …: realistic, with a look-alike in the object's place."""
