"""What effects of the real world do to a scene."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable

import numpy as np

from synthetic.effects import Effects, stream
from synthetic.scene import Body, ObjectState, PlatformScene, SceneAt, direction, transform
from synthetic.world import meshes
from synthetic.world.chamfers import chamfered
from synthetic.world.clutter import cluttered
from synthetic.world.prints import printed
from synthetic.world.reflections import reflecting
from synthetic.world.worn_table import worn
from tracker.conventions import FloatArray
from tracker.geometry import so3

SIZE_M = 0.0003
"""Greatest deviation of an edge's length [m]: what ISO 2768's class m grants parts of 30 to 120 mm, and about
what the recorded objects' paint takes from their edges."""

MOVING, SPEED, RATE = 1 / 2, 0.3, 2.0
"""Share of single scenes whose object moves, and its greatest speed [m/s] and rate of turn [rad/s]: as fast
as fingers push and carry."""


CONTACT, CONTACT_M = (0.0, 1.0), (0.002, 0.008)
"""Share of the sky's light that is gone where the object stands, and how far that reaches [m]: see
`scripts/measure_edges.py`."""


def resized(scene: PlatformScene, rng: np.random.Generator) -> PlatformScene:
    """The scene with a cuboid whose edges are a little off; its centre stays."""
    change = rng.uniform(-SIZE_M, SIZE_M, 3)

    def other(body: Body) -> Body:
        mesh = meshes.box(f"{body.mesh.key}_{change.tobytes().hex()}", body.size + change)
        return dataclasses.replace(body, mesh=mesh)

    return scene.with_cuboid(other)


def standing(scene: PlatformScene, rng: np.random.Generator) -> PlatformScene:
    """The scene with shade, drawn from `rng`, where its cuboid stands."""
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
"""In the order in which they are made."""


def with_effects(scene: PlatformScene, effects: Effects, seed: int, number: int) -> PlatformScene:
    """The scene with the effects that change scenes; all scenes of one `number` get the same ones.

    Args:
        scene: a tidy one.
        effects: those requested.
        seed: of everything random.
        number: of the single scene or of the motion.
    """
    for name in (name for name in _CHANGES if name in effects.names):
        scene = _CHANGES[name](scene, stream(name, seed, number))
    return scene


def still_at(scene: PlatformScene, timestamp: float, effects: Effects, seed: int, number: int) -> SceneAt:
    """A single scene around its time stamp [s], at which it is exactly `scene`."""
    rng = stream("motion_blur", seed, number, 1)
    if not effects.motion_blur or rng.random() >= MOVING:
        return lambda _: scene
    azimuth, speed, rate = rng.uniform([0.0, 0.0, -RATE], [2 * np.pi, SPEED, RATE])
    velocity = speed * direction(azimuth)

    @functools.cache
    def at(time: float) -> PlatformScene:
        return _moved(scene, (time - timestamp) * velocity, (time - timestamp) * rate)

    return at


def _moved(scene: PlatformScene, shift: FloatArray, angle: float) -> PlatformScene:
    """The scene with what bears labels moved [m], and turned about the vertical through its middle [rad]."""
    shown = [body.world_from_body[:3, 3] for body in scene.bodies if np.any(body.labels)]
    if not shown or not (angle or shift.any()):
        return scene
    middle, turn = np.mean(shown, axis=0), so3.exp([0.0, 0.0, angle])
    motion = transform(turn, middle + shift - turn @ middle)
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
