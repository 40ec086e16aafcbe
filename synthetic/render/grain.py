"""Grain, scratches and blotches: smooth noise that is fixed to a body's surface."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from tracker.compiled import compiled
from tracker.conventions import Array

_SIZES_M = (0.0011, 0.006, 0.03)
"""Sizes of grain, scratches and blotches [m]."""

_CELLS = 32
"""The noise repeats after so many cells along each axis; the sizes do so at different places."""


@lru_cache(maxsize=1)
def lattice() -> Array:
    """(32, 32, 32) float32 random values, scaled so that the sum of all sizes deviates by about 1."""
    values = np.random.default_rng(0).uniform(-1.0, 1.0, (_CELLS,) * 3)
    scaled: Array = values * np.sqrt(3.0 / (len(_SIZES_M) * (2.0 / 3.0) ** 3))
    return scaled.astype(np.float32)


@compiled
def grain(
    lattice: Array,
    world_from_body: Array,
    body: int,
    px: float,
    py: float,
    pz: float,
    seed: int,
    footprint: float,
) -> float:
    """Noise at a point of the world; sizes that a pixel of `footprint` [m] does not resolve are left out."""
    pose = world_from_body
    qx, qy, qz = px - pose[body, 0, 3], py - pose[body, 1, 3], pz - pose[body, 2, 3]
    x = pose[body, 0, 0] * qx + pose[body, 1, 0] * qy + pose[body, 2, 0] * qz
    y = pose[body, 0, 1] * qx + pose[body, 1, 1] * qy + pose[body, 2, 1] * qz
    z = pose[body, 0, 2] * qx + pose[body, 1, 2] * qy + pose[body, 2, 2] * qz
    # Off the origin by shares of a cell that depend on the body, so that no face lies in a lattice plane.
    x += 1e-3 * ((seed & 255) + 0.37)
    y += 1e-3 * (((seed >> 8) & 255) + 0.71)
    z += 1e-3 * (((seed >> 16) & 255) + 0.13)
    total = 0.0
    for octave in range(len(_SIZES_M)):
        size = _SIZES_M[octave]
        if size > footprint:
            total += _noise(lattice, x / size, y / size, z / size)
    return total


@compiled
def _noise(lattice: Array, x: float, y: float, z: float) -> float:
    """Random values at whole numbers, and a smooth way between them."""
    floor_x, floor_y, floor_z = np.floor(x), np.floor(y), np.floor(z)
    u, v, w = _smooth(x - floor_x), _smooth(y - floor_y), _smooth(z - floor_z)
    i, j, k = int(floor_x) & (_CELLS - 1), int(floor_y) & (_CELLS - 1), int(floor_z) & (_CELLS - 1)
    i1, j1, k1 = (i + 1) & (_CELLS - 1), (j + 1) & (_CELLS - 1), (k + 1) & (_CELLS - 1)
    near = (1 - w) * lattice[i, j, k] + w * lattice[i, j, k1]
    left = (1 - v) * near + v * ((1 - w) * lattice[i, j1, k] + w * lattice[i, j1, k1])
    far = (1 - w) * lattice[i1, j, k] + w * lattice[i1, j, k1]
    right = (1 - v) * far + v * ((1 - w) * lattice[i1, j1, k] + w * lattice[i1, j1, k1])
    return float((1 - u) * left + u * right)


@compiled
def _smooth(share: float) -> float:
    """From 0 to 1 with level ends: linear steps would show the lattice's planes."""
    return share * share * (3.0 - 2.0 * share)
