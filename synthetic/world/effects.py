"""Changes that the effects make to a scene."""

import dataclasses
import functools
from collections.abc import Callable, Container

import numpy as np

from synthetic.effects import stream
from synthetic.scene import ObjectState, PlatformScene, SceneAt, direction
from synthetic.world import meshes
from synthetic.world.chamfers import chamfered
from synthetic.world.clutter import cluttered
from synthetic.world.prints import printed
from synthetic.world.reflections import reflecting
from synthetic.world.worn_table import worn
from tracker.conventions import FloatArray
from tracker.geometry import so3

SIZE_M = 0.0003
"""Largest error of an edge length [m]: the tolerance of ISO 2768-m for parts of 30 to 120 mm, and about the
thickness that paint takes from the recorded objects' edges."""

MOVING, SPEED, RATE = 1 / 2, 0.3, 2.0
"""Share of single scenes whose object moves, and its largest speed [m/s] and rate of rotation [rad/s]: as
fast as fingers push and carry."""


CONTACT, CONTACT_M = (0.0, 1.0), (0.002, 0.008)
"""Ranges of the share of the sky's light hidden where the object stands, and of the reach of this shade [m]:
see `scripts/measure_edges.py`."""


def resized(scene: PlatformScene, rng: np.random.Generator) -> PlatformScene:
    """Return the scene with random errors of the cuboid's edge lengths; its centre stays."""
    change = rng.uniform(-SIZE_M, SIZE_M, 3)
    return scene.with_cuboid(lambda body: dataclasses.replace(body, mesh=meshes.box(body.size + change)))


def standing(scene: PlatformScene, rng: np.random.Generator) -> PlatformScene:
    """Return the scene with random contact shade below its cuboid."""
    return dataclasses.replace(scene, contact=(float(rng.uniform(*CONTACT)), float(rng.uniform(*CONTACT_M))))


_CHANGES: dict[str, Callable[[PlatformScene, np.random.Generator], PlatformScene]] = {
    "sizes": resized,
    "chamfers": chamfered,
    "surface": printed,
    "table": worn,
    "reflections": reflecting,
    "contact": standing,
    "clutter": cluttered,
}
"""Changes of scenes by effect, in the order of their application."""


def with_effects(scene: PlatformScene, effects: Container[str], seed: int, number: int) -> PlatformScene:
    """Apply the effects that change scenes; all scenes of one seed and number get the same ones."""
    for name in (name for name in _CHANGES if name in effects):
        scene = _CHANGES[name](scene, stream(name, seed, number))
    return scene


def still_at(
    scene: PlatformScene, timestamp: float, effects: Container[str], seed: int, number: int
) -> SceneAt:
    """Return a single scene as a function of time, equal to `scene` at its timestamp [s]."""
    rng = stream("motion_blur", seed, number, 1)
    if "motion_blur" not in effects or rng.random() >= MOVING:
        return lambda _: scene
    azimuth, speed, rate = rng.uniform([0.0, 0.0, -RATE], [2 * np.pi, SPEED, RATE])
    velocity = speed * direction(azimuth)

    @functools.cache
    def at(time: float) -> PlatformScene:
        return _moved(scene, (time - timestamp) * velocity, (time - timestamp) * rate)

    return at


def _moved(scene: PlatformScene, shift: FloatArray, angle: float) -> PlatformScene:
    """Return the scene with labelled bodies moved [m] and turned about their vertical axis [rad]."""
    shown = [body.world_from_body[:3, 3] for body in scene.bodies if np.any(body.labels)]
    if not shown or not (angle or shift.any()):
        return scene
    middle, turn = np.mean(shown, axis=0), so3.exp([0.0, 0.0, angle])
    motion = so3.transform(turn, middle + shift - turn @ middle)
    bodies = tuple(
        dataclasses.replace(body, world_from_body=motion @ body.world_from_body)
        if np.any(body.labels)
        else body
        for body in scene.bodies
    )
    objects = tuple(
        ObjectState(one.name, turn @ one.position + motion[:3, 3], turn @ one.rotation)
        for one in scene.objects
    )
    return dataclasses.replace(scene, bodies=bodies, objects=objects)
