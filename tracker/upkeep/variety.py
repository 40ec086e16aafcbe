"""Chooses sightings of an object in many different poses."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tracker.errors import CalibrationError
from tracker.geometry import so3
from tracker.upkeep.sightings import Sighting

APART = 8e-3, np.radians(8.0)
"""Motion from which on a pose is another one [m, rad]."""

LEAST = 18
"""Different poses that must be seen."""

TURNED = np.radians(30.0)
"""Turn between some of them [rad]: an object that is only moved shows the same edges."""

SPREAD = 0.03
"""Standard deviation of their places, as a length of all axes together [m]."""

SMEARED = 0.3e-3
"""Motion between the pictures of one frame beyond which it is left out [m]."""


def different(name: str, seen: Sequence[Sequence[Sighting]], most: int) -> list[tuple[int, Sighting]]:
    """Up to `most` sightings of the object `name` in poses that differ, each with the number of its footage.

    Raises:
        CalibrationError: there are too few.
    """
    sharp = [(k, one) for k, part in enumerate(seen) for one in part if _smear(one) < SMEARED]
    if not sharp:
        blurred = sum(map(len, seen))
        more = f"; in {blurred} more it moved between the cameras' pictures" if blurred else ""
        raise CalibrationError(f"refine: found no frame in which {name} is surely seen{more}")
    chosen: list[tuple[int, Sighting]] = []
    for k, one in sharp:
        if all(_apart(one, other) for _, other in chosen):
            chosen.append((k, one))
    places = np.array([one.position for _, one in chosen])
    turn = max(so3.angle_between(one.rotation, chosen[0][1].rotation) for _, one in chosen)
    spread = float(np.sqrt(places.var(axis=0).sum()))
    if len(chosen) < LEAST or spread < SPREAD or turn < TURNED:
        raise CalibrationError(
            f"refine: found {len(chosen)} of the {LEAST} different poses or more in which {name} must be "
            f"seen; they spread by {1e3 * spread:.0f} mm (expected {1e3 * SPREAD:.0f}) and turn by up to "
            f"{np.degrees(turn):.0f}° (expected {np.degrees(TURNED):.0f}): move and turn it all over the "
            "arena"
        )
    picks = np.unique(np.linspace(0, len(chosen) - 1, min(most, len(chosen))).round().astype(int))
    return [chosen[k] for k in picks]


def _smear(one: Sighting) -> float:
    """How far the object moved between the first and the last picture of a frame [m]."""
    return 0.0 if one.velocity is None else one.skew * float(np.linalg.norm(one.velocity[:3]))


def _apart(one: Sighting, other: Sighting) -> bool:
    moved = np.linalg.norm(one.position - other.position)
    return bool(moved > APART[0] or so3.angle_between(one.rotation, other.rotation) > APART[1])
