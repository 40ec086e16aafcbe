"""Which die belongs to which place of a goal."""

from __future__ import annotations

import dataclasses

import numpy as np
import numpy.typing as npt
from scipy.optimize import linear_sum_assignment

from tracker.conventions import Array, FloatArray
from tracker.tasks.rearrange_dice.goals import TOLERANCE, finite_positions

NO_DIE = -1
"""Index of the die at a place that gets none."""


@dataclasses.dataclass(frozen=True, eq=False)
class Assignment:
    """Pairs of places and dice with the smallest sum of distances; arrays are read-only."""

    die: Array
    """(N,) index of the die for each of the goal's places, NO_DIE where there are not enough dice."""
    distance: FloatArray
    """(N,) distance [m] between place and die; NaN where there is no die."""

    def __post_init__(self) -> None:
        for key, kind in (("die", np.int64), ("distance", np.float64)):
            values = np.array(getattr(self, key), dtype=kind)
            values.flags.writeable = False
            object.__setattr__(self, key, values)

    @property
    def pairs(self) -> list[tuple[int, int]]:
        """(place, die) of every pair."""
        return [(place, int(die)) for place, die in enumerate(self.die) if die != NO_DIE]

    @property
    def total(self) -> float:
        """Sum of the distances [m]."""
        return float(np.nansum(self.distance))

    def count_within(self, distance: float = TOLERANCE) -> int:
        """Number of places with a die at most `distance` [m] away."""
        return int(np.count_nonzero(self.distance <= distance))


def assign(goal: npt.ArrayLike, positions: npt.ArrayLike) -> Assignment:
    """Pair the places of a goal with dice so that the sum of their distances is smallest.

    With fewer dice than places, or more, as many pairs as there can be. Deterministic.

    Args:
        goal: (N, 3) [m] places in the world.
        positions: (M, 3) [m] centres of dice in the world; none will do.

    Raises:
        TaskError: goal or positions are of another shape or not finite.
    """
    places, dice = finite_positions(goal, "goal"), finite_positions(positions, "dice")
    distances = np.linalg.norm(places[:, None] - dice, axis=-1)
    chosen, partners = linear_sum_assignment(distances)
    die = np.full(len(places), NO_DIE, dtype=np.int64)
    distance = np.full(len(places), np.nan)
    die[chosen], distance[chosen] = partners, distances[chosen, partners]
    return Assignment(die, distance)
