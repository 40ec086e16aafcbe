"""Motions whose pose is known at any time: an object that flies between points of the arena."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tracker.conventions import FloatArray
from tracker.geometry import so3

SPEED = 0.5
"""Typical of an object that is thrown or pushed hard [m/s]."""

REACH, HEIGHTS = 0.12, (0.06, 0.12)
"""Turning points are so near the arena's axis, at such heights [m]: all cameras see the object there, and no
corner of it touches wall or table."""

LEAST = 0.1
"""Distance of neighbouring turning points [m]: less than REACH, so that there is one for each."""

TURN_RATES = (0.5, 2.5)
"""Least and greatest rate of rotation while moving [rad/s]."""

BULGE = 0.35
"""Greatest height of a curved leg over its chord, relative to the chord."""

REST_SECONDS = (0.3, 0.8)
"""Of a leg that goes nowhere."""

KINDS, SHARES = ("straight", "curved", "eased", "rest"), (0.4, 0.25, 0.2, 0.15)
"""Kinds of legs and how often they come: straight at one speed; along a parabola; straight, but begun and
ended at rest; at rest."""


@dataclass(frozen=True, eq=False)
class Leg:
    """The way from one turning point to the next."""

    begin: float
    """[s]"""
    seconds: float
    """How long it takes."""
    start: FloatArray
    """(3,) position at its begin [m]."""
    chord: FloatArray
    """(3,) from there to the end [m]."""
    bulge: FloatArray
    """(3,) by which its middle is off the chord's [m]."""
    rotation: FloatArray
    """(3, 3) world from object at its begin."""
    turn: FloatArray
    """(3,) rotation vector of the whole leg, along world axes [rad]."""
    eased: bool
    """Whether it begins and ends at rest."""

    @property
    def end(self) -> float:
        """When it ends [s]."""
        return self.begin + self.seconds

    def pose(self, time: float) -> tuple[FloatArray, FloatArray]:
        """Position (3,) [m] and rotation (3, 3) at a time [s]; before and after the leg those of its ends."""
        share = min(max((time - self.begin) / self.seconds, 0.0), 1.0)
        if self.eased:
            share = share * share * (3.0 - 2.0 * share)
        position: FloatArray = self.start + share * self.chord + 4.0 * share * (1.0 - share) * self.bulge
        rotation: FloatArray = so3.exp(share * self.turn) @ self.rotation
        return position, rotation


@dataclass(frozen=True, eq=False)
class Motion:
    """Legs, one after the other without gaps."""

    legs: tuple[Leg, ...]
    """The first begins with the motion."""

    def leg(self, time: float) -> Leg:
        """The leg of a time [s]; the first and the last hold before and after the motion."""
        ends = [leg.end for leg in self.legs]
        return self.legs[min(int(np.searchsorted(ends, time, side="right")), len(ends) - 1)]

    def pose(self, time: float) -> tuple[FloatArray, FloatArray]:
        """Position (3,) [m] and rotation (3, 3) world from object at a time [s]."""
        return self.leg(time).pose(time)

    def speed(self, time: float) -> float:
        """Of the object's centre [m/s], by the millisecond before."""
        step = 1e-3
        return float(np.linalg.norm(self.pose(time)[0] - self.pose(time - step)[0])) / step


def random_motion(rng: np.random.Generator, begin: float, seconds: float) -> Motion:
    """A motion that begins at a time and lasts for at least so long [s]; its first leg is a rest."""
    position, rotation = _point(rng), so3.matrix_from_quaternion(rng.standard_normal(4))
    legs = [_leg(rng, "rest", begin, position, rotation)]
    while legs[-1].end < begin + seconds:
        last = legs[-1]
        kind = str(rng.choice(KINDS, p=SHARES))
        legs.append(_leg(rng, kind, last.end, *last.pose(last.end)))
    return Motion(tuple(legs))


def _leg(rng: np.random.Generator, kind: str, begin: float, start: FloatArray, rotation: FloatArray) -> Leg:
    nowhere = np.zeros(3)
    if kind == "rest":
        return Leg(begin, rng.uniform(*REST_SECONDS), start, nowhere, nowhere, rotation, nowhere, False)
    end = _point(rng)
    while np.linalg.norm(end - start) < LEAST:
        end = _point(rng)
    chord = end - start
    length = float(np.linalg.norm(chord))
    seconds = length / (SPEED * rng.uniform(0.8, 1.2))
    bulge = nowhere
    if kind == "curved":
        across = np.cross([0.0, 0.0, 1.0], chord)
        # Towards the arena's axis, where there is room.
        side = -np.sign(across @ (start + end)) or 1.0
        bulge = side * rng.uniform(0.3, 1.0) * BULGE * length * across / np.linalg.norm(across)
    axis = rng.standard_normal(3)
    turn = seconds * rng.uniform(*TURN_RATES) * axis / np.linalg.norm(axis)
    return Leg(begin, seconds, start, chord, bulge, rotation, turn, kind == "eased")


def _point(rng: np.random.Generator) -> FloatArray:
    angle, radius = rng.uniform(0, 2 * np.pi), REACH * np.sqrt(rng.random())
    return np.array([radius * np.cos(angle), radius * np.sin(angle), rng.uniform(*HEIGHTS)])
