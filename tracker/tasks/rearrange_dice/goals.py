"""Goals of the dice task: 25 places in the arena, one for each die."""

from __future__ import annotations

import functools

import numpy as np
import numpy.typing as npt

from tracker.checks import is_whole
from tracker.conventions import Array, FloatArray
from tracker.errors import TaskError, shown
from tracker.tasks.checks import numbers

NUM_DICE = 25
"""Number of dice, and of places in a goal."""

DIE_WIDTH = 0.022
"""Edge of a die [m]."""

TOLERANCE = 0.004
"""By how much the box in which a die counts as placed is wider than a die [m]."""

ARENA_RADIUS = 0.19
"""Places of dice lie within this distance of the arena's centre [m]."""

CELLS_PER_ROW = 17
"""Cells, each as wide as a die, along each side of the grid."""

SLACK = 1e-9
"""Overlap of a place with the arena's border or floor that is due to rounding [m]."""


def cell_centers() -> FloatArray:
    """Centres (17, 17, 3) [m] of all cells of the grid: first axis along the world's x, second along y."""
    steps = (np.arange(CELLS_PER_ROW) - (CELLS_PER_ROW - 1) / 2) * DIE_WIDTH
    x, y = np.meshgrid(steps, steps, indexing="ij")
    return np.stack([x, y, np.full_like(x, DIE_WIDTH / 2)], axis=-1)


def in_arena(positions: Array) -> Array:
    """Which of the dice whose centres (..., 3) [m] are given lie, axis-aligned, inside the arena: bool."""
    return reach(positions) <= ARENA_RADIUS + SLACK


def reach(positions: Array) -> FloatArray:
    """Distance [m] of the outermost corner of axis-aligned dice at (..., 3) [m] from the arena's axis."""
    corner = np.abs(positions[..., :2]) + DIE_WIDTH / 2
    return np.asarray(np.hypot(corner[..., 0], corner[..., 1]), dtype=np.float64)


def cells() -> FloatArray:
    """Centres (N, 3) [m] of the cells that lie inside the arena, ordered by x, then by y."""
    return _cells().copy()


@functools.cache
def _cells() -> FloatArray:
    centers = cell_centers().reshape(-1, 3)
    return centers[in_arena(centers)]


def sample_goal(rng: int | np.random.Generator) -> FloatArray:
    """A random goal (25, 3) [m]: different cells, all equally likely.

    Args:
        rng: a generator, or the seed of one.

    Raises:
        TaskError: it is neither.
    """
    if not isinstance(rng, np.random.Generator) and not (is_whole(rng) and rng >= 0):
        valid = "a whole number from 0 or a numpy.random.Generator"
        raise TaskError(f"rng: found {shown(rng)}, expected {valid}")
    chosen = np.random.default_rng(rng).choice(len(_cells()), NUM_DICE, replace=False)
    return _cells()[chosen]


def validate_goal(goal: npt.ArrayLike) -> FloatArray:
    """The goal as an array (25, 3) [m] of its own.

    As on the platform, places may overlap and be above the floor.

    Raises:
        TaskError: it is not 25 positions, or one of them is outside the arena or below its floor.
    """
    places = finite_positions(goal, "goal")
    if len(places) != NUM_DICE:
        raise TaskError(f"goal: found {len(places)} positions, expected {NUM_DICE}")
    outside = ~in_arena(places)
    if outside.any():
        first = int(np.argmax(outside))
        raise TaskError(
            f"goal: position {first}, {told(places[first])}: its die reaches {reach(places[first]):.4g} m "
            f"from the arena's centre, expected at most {ARENA_RADIUS} m"
        )
    low = places[:, 2] < DIE_WIDTH / 2 - SLACK
    if low.any():
        first = int(np.argmax(low))
        raise TaskError(
            f"goal: position {first}, {told(places[first])}: found the height {places[first, 2]:g} m, "
            f"expected at least half a die, {DIE_WIDTH / 2} m"
        )
    return places


def finite_positions(value: npt.ArrayLike, what: str) -> FloatArray:
    """Positions (N, 3) [m], perhaps none, as an array of its own; TaskError where `what` is none."""
    places = numbers(what, value, finite=True)
    if places.size == 0 and places.ndim in (1, 2):
        return np.empty((0, 3))
    if places.ndim != 2 or places.shape[1] != 3:
        raise TaskError(f"{what}: found shape {places.shape}, expected (N, 3): N × (x, y, z)")
    return places


def told(position: Array) -> str:
    """A position in a message."""
    return f"({', '.join(f'{value:g}' for value in position)})"
