"""Recorded triplets, rendered again with the same calibration and pose.

The pose is the tracker's estimate. Calibrated worlds float some millimetres above or below the table, so
object and cameras are raised together until the object rests on it.
"""

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np

import tracker
from benchmarks.data.recorded import triplet
from synthetic.camera.sensor import CameraSettings, Sensor, linear
from synthetic.camera.shot import QUALITIES, CameraShot, shoot
from synthetic.camera.units import Unit, units_of
from synthetic.effects import chosen_effects
from synthetic.look.appearance import random_lighting, random_look
from synthetic.scene import PlatformScene
from synthetic.world.effects import with_effects
from synthetic.world.fingers import random_fingers
from synthetic.world.placement import lowest
from synthetic.world.platform import Platform
from tracker.conventions import Array, FloatArray, Image
from tracker.geometry.camera import Camera

POSED = {"cube_v1": "new", "cube_v2": "new", "cuboid_2x2x8_v2": "old"}
"""Objects with a recorded triplet, and how its images were recorded."""

_DARK = 30
"""Value below which pixels, the dark around the arena, are ignored when light is compared."""

_TRIES, _SEEN = 8, 0.8
"""Number of draws of fingers, until every camera sees this share of the object."""


@dataclasses.dataclass(frozen=True, eq=False)
class View:
    """One image, its labels and its camera."""

    image: Image
    """(H, W, 3) uint8 BGR."""
    labels: Image
    """(H, W) uint8 label map: 0 other, 1 red … 6 yellow."""
    camera: Camera
    """The camera that took it."""


@dataclasses.dataclass(frozen=True, eq=False)
class Triplet:
    """Images of one object from all cameras, and its pose."""

    model: tracker.CuboidModel
    views: tuple[View, ...]
    position: FloatArray
    """(3,) position [m]."""
    rotation: FloatArray
    """(3, 3) world_from_object."""


def recorded(real: Path, name: str) -> Triplet:
    """Return an object's recorded triplet, with its hand-made masks and the tracker's pose."""
    detector, taken = triplet(real, name, corrected=False)
    pose = detector.detect([image.image for image in taken]).object_pose
    if pose is None:
        raise SystemExit(f"{real / 'pose' / name}: the tracker finds no pose")
    pairs = zip(taken, detector.rig, strict=True)
    views = tuple(View(image.image, image.labels, camera) for image, camera in pairs)
    return Triplet(detector.model, views, pose.position, pose.rotation)


def redrawn(
    record: Triplet, effects: str, draws: int, seed: int, *, blur: float | None = None
) -> list[Triplet]:
    """Render the triplet `draws` times, from `seed` on, see `restaged`; `effects` as on the command line."""
    chosen = chosen_effects(effects)
    with Platform(record.model.name) as platform:
        return [restaged(platform, record, seed + k, chosen, blur=blur) for k in range(draws)]


def restaged(
    platform: Platform, record: Triplet, seed: int, effects: Sequence[str], *, blur: float | None = None
) -> Triplet:
    """Render the triplet with the generator, with colours, light and fingers drawn from `seed`.

    `blur` [px at 540] replaces the sensor's random blur.
    """
    rng = np.random.default_rng(seed)
    raised = np.array([0.0, 0.0, -lowest(record.model.size, record.rotation) - record.position[2]])
    position = record.position + raised
    look, lighting = random_look(rng, platform.model), random_lighting(rng)
    sensor = Sensor.sample(rng, POSED[platform.object_name])
    if blur is not None:
        sensor = dataclasses.replace(sensor, psf_sigma=blur)
    cameras = tuple(_raised(view.camera, raised) for view in record.views)
    units = units_of(tracker.CameraRig(cameras), sensor, rng, effects, seed, 0)
    states = platform.object_states(position[None], record.rotation[None])
    for _ in range(_TRIES):
        joints, _ = random_fingers(platform, states, rng, 0.0)
        scene = platform.scene(states, joints, look, lighting, {})
        scene = with_effects(scene, effects, seed, 0)
        first = [_taken(scene, unit, "fast", seed) for unit in units]
        if min(_share(shot) for shot in first) > _SEEN:
            break
    views = []
    for view, unit, shot in zip(record.views, units, first, strict=True):
        lit = dataclasses.replace(unit, settings=_like(unit, shot, view))
        taken = _taken(scene, lit, "default", seed)
        views.append(View(taken.image, taken.labels, unit.camera))
    return Triplet(record.model, tuple(views), position, record.rotation)


def _taken(scene: PlatformScene, unit: Unit, quality: str, seed: int) -> CameraShot:
    noise = np.random.default_rng([seed, unit.camera.height])
    return shoot((scene,), unit, QUALITIES[quality], noise)


def _share(shot: CameraShot) -> float:
    return np.count_nonzero(shot.labels) / max(np.count_nonzero(shot.alone), 1)


def _raised(camera: Camera, by: FloatArray) -> Camera:
    transform = camera.camera_from_world.copy()
    transform[:3, 3] -= transform[:3, :3] @ by
    return dataclasses.replace(camera, camera_from_world=transform)


def _like(unit: Unit, first: CameraShot, view: View) -> CameraSettings:
    """Return settings that give the object's surroundings the same light as in the recorded image."""
    here = _light_around(first.image, first.labels, unit.sensor)
    there = _light_around(view.image, view.labels, unit.sensor)
    gains = unit.settings.gains * np.clip(there / here, 0.2, 5.0)
    return dataclasses.replace(unit.settings, gains=gains)


def _light_around(image: Image, labels: Image, sensor: Sensor) -> FloatArray:
    """Return the median light (3,) BGR of pixels that are neither object nor almost black."""
    values: Array = image[(labels == 0) & (image.max(axis=2) > _DARK)]
    result: FloatArray = np.median(linear(values, sensor.gamma), axis=0) + sensor.black
    return result
