"""Where a search without a prior looks: points over the arena, rotations over SO(3)."""

from __future__ import annotations

import math

import numpy as np

from tracker.conventions import FloatArray
from tracker.geometry import so3

ARENA_RADIUS = 0.235
ARENA_BOTTOM, ARENA_TOP = -0.015, 0.185
"""The space that is searched for the object's centre [m]; real worlds lie up to 6 mm off the table."""

GRID_STEP = 0.02
ROTATIONS = 1400
"""Rotations of the even grid: neighbours are about 22° apart."""


def even_rotations(count: int) -> FloatArray:
    """(count, 3, 3) rotations spread evenly over SO(3).

    Super-Fibonacci spirals: M. Alexa, "Super-Fibonacci Spirals: Fast, Low-Discrepancy Sampling of
    SO(3)", CVPR 2022.
    """
    phi, psi = math.sqrt(2.0), 1.533751168755204288118041
    s = np.arange(count) + 0.5
    r, big_r = np.sqrt(s / count), np.sqrt(1 - s / count)
    alpha, beta = 2 * np.pi * s / phi, 2 * np.pi * s / psi
    quaternions = np.stack(
        [r * np.sin(alpha), r * np.cos(alpha), big_r * np.sin(beta), big_r * np.cos(beta)], axis=1
    )
    return np.ascontiguousarray([so3.matrix_from_quaternion(q) for q in quaternions])


def arena_points() -> FloatArray:
    """(N, 3) grid over the arena [m]."""
    xy = np.arange(-ARENA_RADIUS, ARENA_RADIUS + 1e-9, GRID_STEP)
    z = np.arange(ARENA_BOTTOM, ARENA_TOP + 1e-9, GRID_STEP)
    points = np.stack(np.meshgrid(xy, xy, z, indexing="ij"), axis=-1).reshape(-1, 3)
    inside = np.hypot(points[:, 0], points[:, 1]) <= ARENA_RADIUS
    return np.ascontiguousarray(points[inside])
