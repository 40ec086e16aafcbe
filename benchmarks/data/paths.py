"""Motions whose pose is known at any time: an object flies between points in the arena."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tracker.conventions import FloatArray
from tracker.geometry import so3

SPEED = 0.5
"""Typical speed of an object that is thrown or pushed hard [m/s]."""

REACH, HEIGHTS = 0.12, (0.06, 0.12)
"""Largest distance of turning points from the arena's axis, and range of their heights [m]: all cameras see
the object there, and none of its corners touches the wall or the table."""

LEAST = 0.1
"""Smallest distance between consecutive turning points [m]; less than REACH, so that one always exists."""

TURN_RATES = (0.5, 2.5)
"""Smallest and largest rate of rotation while moving [rad/s]."""

BULGE = 0.35
"""Largest height of a curved leg over its chord, relative to the chord."""

REST_SECONDS = (0.3, 0.8)
"""Shortest and longest duration of a rest [s]."""

KINDS, SHARES = ("straight", "curved", "eased", "rest"), (0.4, 0.25, 0.2, 0.15)
"""Kinds of legs and their probabilities: straight at constant speed; along a parabola; straight, starting and
ending at rest; at rest."""


@dataclass(frozen=True, eq=False)
class Leg:
    """The motion from one turning point to the next."""

    begin: float
    """Start time [s]."""
    seconds: float
    """Duration [s]."""
    start: FloatArray
    """(3,) position at the start [m]."""
    chord: FloatArray
    """(3,) vector from the start to the end [m]."""
    bulge: FloatArray
    """(3,) displacement of the path's middle from that of the chord [m]."""
    rotation: FloatArray
    """(3, 3) world_from_object at the start."""
    turn: FloatArray
    """(3,) rotation vector of the whole leg, along world axes [rad]."""
    eased: bool
    """Whether it starts and ends at rest."""

    @property
    def end(self) -> float:
        """End time [s]."""
        return self.begin + self.seconds

    def pose(self, time: float) -> tuple[FloatArray, FloatArray]:
        """Return position (3,) [m] and rotation (3, 3) at a time [s]; outside the leg, those at its ends."""
        share = min(max((time - self.begin) / self.seconds, 0.0), 1.0)
        if self.eased:
            share = share * share * (3.0 - 2.0 * share)
        position: FloatArray = self.start + share * self.chord + 4.0 * share * (1.0 - share) * self.bulge
        rotation: FloatArray = so3.exp(share * self.turn) @ self.rotation
        return position, rotation


@dataclass(frozen=True, eq=False)
class Motion:
    """Consecutive legs without gaps."""

    legs: tuple[Leg, ...]
    """The first begins with the motion."""

    def leg(self, time: float) -> Leg:
        """Return the leg at a time [s]; the first and the last also cover times outside the motion."""
        ends = [leg.end for leg in self.legs]
        return self.legs[min(int(np.searchsorted(ends, time, side="right")), len(ends) - 1)]

    def pose(self, time: float) -> tuple[FloatArray, FloatArray]:
        """Return position (3,) [m] and rotation (3, 3) world_from_object at a time [s]."""
        return self.leg(time).pose(time)

    def speed(self, time: float) -> float:
        """Return the speed of the object's centre [m/s] over the preceding millisecond."""
        step = 1e-3
        return float(np.linalg.norm(self.pose(time)[0] - self.pose(time - step)[0])) / step


def random_motion(rng: np.random.Generator, begin: float, seconds: float) -> Motion:
    """Draw a motion that starts at a time and lasts at least `seconds` [s]; its first leg is a rest."""
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
        # Bulge towards the arena's axis, where there is room.
        side = -np.sign(across @ (start + end)) or 1.0
        bulge = side * rng.uniform(0.3, 1.0) * BULGE * length * across / np.linalg.norm(across)
    axis = rng.standard_normal(3)
    turn = seconds * rng.uniform(*TURN_RATES) * axis / np.linalg.norm(axis)
    return Leg(begin, seconds, start, chord, bulge, rotation, turn, kind == "eased")


def _point(rng: np.random.Generator) -> FloatArray:
    angle, radius = rng.uniform(0, 2 * np.pi), REACH * np.sqrt(rng.random())
    return np.array([radius * np.cos(angle), radius * np.sin(angle), rng.uniform(*HEIGHTS)])
