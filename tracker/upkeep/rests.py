"""Which sightings show the object at rest, in a place of its own."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from tracker.conventions import FloatArray
from tracker.geometry import so3
from tracker.upkeep.sightings import Sighting

LEVEL = np.radians(6.0)
"""Greatest tilt of an object's face against z = 0: that of an object at rest, and of the world's [rad]."""

SLOW = 5e-3, np.radians(5.0)
"""Velocities below which an object may be at rest [m/s, rad/s]."""

FRAMES = 3
"""Frames in a row of a film in which it must be."""

SAME = 3e-3, np.radians(2.0)
"""Motion within which an object at rest is still in the same place [m, rad]."""


def resting(sightings: Iterable[Sighting]) -> list[Sighting]:
    """One sighting of each place in which the object may rest; every still that shows it level is one.

    It may be held still, too: who asks for rests must expect some of these.
    """
    runs: list[list[Sighting]] = []
    for one in sightings:
        if not (_level(one.rotation) and _still(one)):
            continue
        last = runs[-1] if runs else None
        if last and not one.begins and one.velocity is not None and _stays(last, one):
            last.append(one)
        else:
            runs.append([one])
    return [run[len(run) // 2] for run in runs if run[0].velocity is None or len(run) >= FRAMES]


def _level(rotation: FloatArray) -> bool:
    return bool(np.abs(rotation[2]).max() > np.cos(LEVEL))


def _still(one: Sighting) -> bool:
    if one.velocity is None:
        return True
    speed, turning = np.linalg.norm(one.velocity[:3]), np.linalg.norm(one.velocity[3:])
    return bool(speed < SLOW[0] and turning < SLOW[1])


def _stays(run: list[Sighting], one: Sighting) -> bool:
    """Whether a sighting follows those of a run without a gap, in the same place."""
    moved = np.linalg.norm(one.position - run[0].position)
    turned = so3.angle_between(one.rotation, run[0].rotation)
    return bool(one.number == run[-1].number + 1 and moved < SAME[0] and turned < SAME[1])
