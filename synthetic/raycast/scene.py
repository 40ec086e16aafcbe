"""What a ray-cast scene holds: one cuboid in an arena, fingers that get in the way, and light.

Colours are linear BGR; 1 is what a sensor without gains turns into 255 where the shading is 1.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from synthetic.look.face_colors import TYPICAL_COLORS_BGR, face_colors
from synthetic.raycast.fingers import Box, Capsule, Motor, ReadOnlyArrays, random_fingers
from tracker.conventions import Array, FloatArray
from tracker.geometry import so3
from tracker.geometry.cuboid import FACE_NORMALS, corners
from tracker.objects.model import CuboidModel

ARENA_RADIUS = 0.19
"""Radius of the table [m]; the wall begins 5 mm further out."""

MAX_CLEARANCE = 0.1
"""Greatest height above the table of the lowest corner of an object in the air [m]."""


@dataclass(frozen=True, eq=False)
class Background(ReadOnlyArrays):
    """The arena: a round table within a wall that widens upwards; beyond is darkness."""

    table_albedo: FloatArray = field(default_factory=lambda: np.full(3, 0.24))
    """(3,) colour of the table."""
    wall_albedo: FloatArray = field(default_factory=lambda: np.full(3, 0.5))
    """(3,) colour of the wall's inside."""
    wall_radii: FloatArray = field(default_factory=lambda: np.array([0.195, 0.239, 0.310]))
    """(3,) the wall's radius [m] at `wall_heights`; straight in between."""
    wall_heights: FloatArray = field(default_factory=lambda: np.array([0.0, 0.105, 0.180]))
    """(3,) increasing from 0 [m]."""
    blotches: FloatArray = field(default_factory=lambda: np.zeros((0, 4)))
    """(N, 4) light spots on the table: centre x, y [m], radius [m] (one sigma), share of light added."""
    cross: FloatArray = field(default_factory=lambda: np.zeros(2))
    """(2,) width and length [m] of the bars of a cross painted at the arena's centre; zeros: no cross."""
    cross_albedo: FloatArray = field(default_factory=lambda: TYPICAL_COLORS_BGR[3] / 255)
    """(3,) colour of the cross."""
    shadow: float = 0.5
    """Share of the table's light that comes from the lamp, and is lost in its shadow."""


@dataclass(frozen=True, eq=False)
class Scene(ReadOnlyArrays):
    """All that a picture shows, in the world's frame."""

    position: FloatArray
    """(3,) the object's centre [m]."""
    rotation: FloatArray | None
    """(3, 3) world from object; None: there is no object."""
    face_albedos: FloatArray
    """(6, 3) colours of the faces, in the order of FACE_NAMES."""
    fingers: tuple[Capsule, ...] = ()
    """Links, joints and tips of all fingers."""
    motors: tuple[Motor, ...] = ()
    """Motors on the fingers."""
    light: FloatArray = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    """(3,) unit vector towards the lamp."""
    background: Background = field(default_factory=Background)
    """Table and wall."""
    dirt: float = 0.03
    """Amplitude of the variation of brightness over a face, relative; table and wall have their own."""
    texture_seed: int = 0
    """Seed of the patterns of dirt and grain."""


def random_scene(
    model: CuboidModel,
    rng: np.random.Generator,
    *,
    occlusion: float = 0.5,
    in_air: float = 0.3,
    on_edge: float = 0.1,
    object_present: bool = True,
) -> Scene:
    """A scene drawn from `rng`.

    Args:
        model: the object.
        rng: source of all randomness.
        occlusion: 0: no fingers; else three, each of which touches the object with this probability and
            is anywhere otherwise.
        in_air: probability that the object hovers, turned at random, at most MAX_CLEARANCE high.
        on_edge: probability that an object that does not hover stands tilted on an edge; else it rests on
            any face.
        object_present: False: an arena without object.
    """
    position, rotation = _random_pose(model.size, rng, in_air, on_edge)
    albedos = face_colors(model)[model.face_labels] / 255 * rng.normal(1.0, 0.04, (6, 3))
    light = _direction(rng.uniform(0, 2 * np.pi), np.radians(rng.uniform(45, 88)))
    background = _random_background(rng)
    box = Box(position, rotation, model.size) if object_present else None
    fingers, motors = random_fingers(rng, box, occlusion) if occlusion > 0 else ((), ())
    return Scene(
        position=position,
        rotation=rotation if object_present else None,
        face_albedos=np.clip(albedos * rng.normal(1.0, 0.04), 0.02, 1.0),
        fingers=fingers,
        motors=motors,
        light=light,
        background=background,
        dirt=rng.uniform(0.01, 0.05),
        texture_seed=int(rng.integers(2**31)),
    )


def _direction(azimuth: float, elevation: float) -> Array:
    level = np.cos(elevation)
    return np.array([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)])


def _in_disc(rng: np.random.Generator, radius: float, shape: tuple[int, ...] = ()) -> tuple[Array, Array]:
    # x and y of points spread evenly over a disc.
    distance, azimuth = radius * np.sqrt(rng.random(shape)), rng.uniform(0, 2 * np.pi, shape)
    return distance * np.cos(azimuth), distance * np.sin(azimuth)


def _random_pose(size: Array, rng: np.random.Generator, in_air: float, on_edge: float) -> tuple[Array, Array]:
    hovers, tilted = rng.random() < in_air, rng.random() < on_edge
    clearance = rng.uniform(0.0, MAX_CLEARANCE) if hovers else 0.0
    while True:
        if hovers:
            rotation = so3.matrix_from_quaternion(rng.standard_normal(4))
        else:
            tilt = so3.exp([rng.uniform(-np.pi / 4, np.pi / 4) * tilted, 0.0, 0.0])
            rotation = so3.exp([0.0, 0.0, rng.uniform(0, 2 * np.pi)]) @ tilt @ _face_up(int(rng.integers(6)))
        offsets = corners(size) @ rotation.T
        x, y = _in_disc(rng, ARENA_RADIUS)
        if np.hypot(x + offsets[:, 0], y + offsets[:, 1]).max() < ARENA_RADIUS:
            return np.array([x, y, clearance - offsets[:, 2].min()]), rotation


def _face_up(face: int) -> Array:
    up, side = FACE_NORMALS[face], FACE_NORMALS[(face + 2) % 6]
    return np.stack([side, np.cross(up, side), up])


def _random_background(rng: np.random.Generator) -> Background:
    count = int(rng.integers(1, 4))
    x, y = _in_disc(rng, ARENA_RADIUS, (count,))
    blotches = np.stack([x, y, rng.uniform(0.03, 0.12, count), rng.uniform(0.1, 0.6, count)], axis=1)
    has_cross = rng.random() < 0.1
    return Background(
        table_albedo=rng.uniform(0.17, 0.27) * rng.normal(1.0, 0.02, 3),
        wall_albedo=rng.uniform(0.42, 0.56) * rng.normal([1.02, 1.0, 0.98], 0.015),
        wall_radii=np.array([0.195, 0.239, 0.310 + rng.uniform(-0.01, 0.02)]),
        wall_heights=np.array([0.0, 0.105, 0.180 + rng.uniform(-0.01, 0.01)]),
        blotches=blotches,
        cross=rng.uniform([0.004, 0.03], [0.01, 0.07]) * has_cross,
        cross_albedo=TYPICAL_COLORS_BGR[3] / 255 * rng.normal(1.0, 0.1, 3),
        shadow=rng.uniform(0.3, 0.6),
    )
