"""Three fingers as capsules and discs: good enough to hide an object and to distract from it."""

from __future__ import annotations

from dataclasses import dataclass, field, fields

import numpy as np

from tracker.conventions import Array, FloatArray

HIP_HEIGHT, HIP_RADIUS = 0.29, 0.075
LINK_LENGTH = 0.165
TIP_RADIUS = 0.0085
MOTOR_RADIUS = 0.022
"""Sizes of a finger [m]: where it hangs, both its links, the rubber sphere at its end, its motors."""

_AZIMUTHS = np.radians([0.0, 120.0, 240.0])
_REACH = (0.08, 0.32)
_ATTEMPTS = 60
_COPPER = np.array([35.0, 85.0, 175.0]) / 255


@dataclass(frozen=True, eq=False)
class ReadOnlyArrays:
    """Base of dataclasses that hold arrays: they are copied, read-only, of doubles."""

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            if isinstance(value, (np.ndarray, list)):
                array = np.array(value, dtype=np.float64)
                array.flags.writeable = False
                object.__setattr__(self, item.name, array)


@dataclass(frozen=True, eq=False)
class Capsule(ReadOnlyArrays):
    """The hull of two spheres; a sphere where `start` equals `end`."""

    start: FloatArray
    """(3,) centre of one sphere [m]."""
    end: FloatArray
    """(3,) centre of the other [m]."""
    radii: tuple[float, float]
    """Radii of the spheres at start and end [m]."""
    albedo: FloatArray
    """(3,) colour, linear BGR."""


@dataclass(frozen=True, eq=False)
class Motor(ReadOnlyArrays):
    """A thin disc with copper spokes: coloured, but no face of the object."""

    center: FloatArray
    """(3,) [m]."""
    normal: FloatArray
    """(3,) unit vector."""
    radius: float = MOTOR_RADIUS
    """[m]"""
    albedo: FloatArray = field(default_factory=lambda: _COPPER.copy())
    """(3,) colour of the spokes, linear BGR."""


@dataclass(frozen=True, eq=False)
class Box(ReadOnlyArrays):
    """The object as an obstacle."""

    position: FloatArray
    """(3,) centre [m]."""
    rotation: FloatArray
    """(3, 3) world from object."""
    size: FloatArray
    """(3,) edge lengths [m]."""

    def distance(self, points: Array) -> Array:
        """Distances (N,) [m] of points (N, 3) from the box; 0 inside."""
        outside = np.maximum(np.abs((points - self.position) @ self.rotation) - self.size / 2, 0.0)
        result: Array = np.linalg.norm(outside, axis=1)
        return result


def random_fingers(
    rng: np.random.Generator, box: Box | None, touch_probability: float
) -> tuple[tuple[Capsule, ...], tuple[Motor, ...]]:
    """Three fingers that do not intersect the object; each touches it with the given probability.

    A finger that finds no way to its place within a number of attempts is left out.
    """
    capsules: list[Capsule] = []
    motors: list[Motor] = []
    dark = rng.random() < 0.1
    color = (rng.uniform(0.1, 0.2) if dark else rng.uniform(0.68, 0.85)) * rng.normal([0.98, 1.0, 1.0], 0.015)
    for azimuth in _AZIMUTHS:
        touches = box is not None and rng.random() < touch_probability
        for attempt in range(_ATTEMPTS):
            if box is not None and touches and attempt < _ATTEMPTS // 2:
                tip = _touching_tip(rng, box)
            else:
                tip = _free_tip(rng)
            finger = _finger(rng, azimuth, tip, color)
            if finger is not None and (box is None or _is_clear(box, *finger)):
                capsules += finger[0]
                motors += finger[1]
                break
    return tuple(capsules), tuple(motors)


def _touching_tip(rng: np.random.Generator, box: Box) -> Array:
    axis, sign = int(rng.integers(3)), rng.choice([-1.0, 1.0])
    point = rng.uniform(-0.45, 0.45, 3) * box.size
    point[axis] = sign * (box.size[axis] / 2 + TIP_RADIUS + rng.uniform(0.0003, 0.004))
    return box.position + box.rotation @ point


def _free_tip(rng: np.random.Generator) -> Array:
    radius, azimuth = 0.17 * np.sqrt(rng.random()), rng.uniform(0, 2 * np.pi)
    height = TIP_RADIUS + rng.choice([0.0005, rng.uniform(0.0, 0.14)])
    return np.array([radius * np.cos(azimuth), radius * np.sin(azimuth), height])


def _finger(
    rng: np.random.Generator, azimuth: float, tip: Array, color: Array
) -> tuple[list[Capsule], list[Motor]] | None:
    """Links from the hip to `tip`, or None where they do not reach or would hit table or wall."""
    radial = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    hip = HIP_RADIUS * radial + [0.0, 0.0, HIP_HEIGHT]
    distance = float(np.linalg.norm(tip - hip))
    swivel = rng.normal(0.0, np.radians(35))
    if not _REACH[0] < distance < _REACH[1] or tip[2] <= TIP_RADIUS:
        return None
    along = (tip - hip) / distance
    outward = radial - (radial @ along) * along
    outward /= np.linalg.norm(outward)
    sideways = np.cross(along, outward)
    bend = np.cos(swivel) * outward + np.sin(swivel) * sideways
    hinge = np.cross(along, bend)
    knee = (hip + tip) / 2 + np.sqrt(LINK_LENGTH**2 - distance**2 / 4) * bend
    if knee[2] < 0.04 or np.hypot(knee[0], knee[1]) > 0.175 + 0.4 * knee[2]:
        return None

    joint, rubber = np.full(3, 0.07), np.full(3, rng.uniform(0.24, 0.4))
    capsules = [
        Capsule(np.array([0.0, 0.0, 0.335]), hip, (0.03, 0.028), color),
        Capsule(hip - 0.032 * hinge, hip + 0.032 * hinge, (0.014, 0.014), joint),
        Capsule(hip, knee, (0.025, 0.022), color),
        Capsule(knee - 0.020 * hinge, knee + 0.020 * hinge, (0.012, 0.012), joint),
        Capsule(knee, tip, (0.021, 0.0065), color),
        Capsule(tip + 0.13 * (knee - tip), tip, (TIP_RADIUS, TIP_RADIUS), rubber),
    ]
    middle = hip + 0.35 * (knee - hip)
    motors = [Motor(middle + side * 0.026 * hinge, hinge) for side in (-1.0, 1.0)]
    return capsules, motors


def _is_clear(box: Box, capsules: list[Capsule], motors: list[Motor]) -> bool:
    """Whether the object touches neither links nor motors, by samples along their axes."""
    share = np.linspace(0.0, 1.0, 65)[:, None]
    for capsule in capsules:
        points = capsule.start + share * (capsule.end - capsule.start)
        radii = capsule.radii[0] + share[:, 0] * (capsule.radii[1] - capsule.radii[0])
        if (box.distance(points) <= radii).any():
            return False
    return all(box.distance(motor.center[None])[0] > motor.radius for motor in motors)
