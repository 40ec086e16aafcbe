"""How much of a scene's light reaches a point: depth maps seen from the lamps and from all over the sky.

A map lies across the direction to the light and holds, per cell, how far towards the light the scene reaches.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from synthetic.render.surfaces import Surfaces
from synthetic.scene import Lighting
from tracker.compiled import compiled
from tracker.conventions import Array, FloatArray

CENTER = (0.0, 0.0, 0.08)
"""Middle of all maps [m]."""

_REACH_M = 0.34
"""Half the width of a map around the centre [m]: the arena and what stands in it."""

_LAMP_CELLS, _SKY_CELLS = 288, 160
LAMP_DIRECTIONS = 7
_LAMP_HALF_ANGLE = np.radians(7.0)
"""Lamps are as wide as this: shadows are sharp at the foot of a thing and soft far from it."""

_SKY_TOP = 0.92
"""Cosine range of the sky's directions is from 0.2 to this: lower ones the walls hide anyway."""


class Maps(NamedTuple):
    """Depth maps of several directions."""

    axes: Array
    """(M, 3, 3) rows: across, across, towards the light."""
    depths: Array
    """(M, K, K) float32 [m] along the third axis."""
    cell: float
    """Size of a cell [m]."""


class Shadows(NamedTuple):
    """Maps of the lamps that cast shadows, LAMP_DIRECTIONS of each in their order, and of the sky."""

    lamps: Maps
    sky: Maps


def shadows_of(surfaces: Surfaces, lighting: Lighting) -> Shadows:
    """Maps for the lamps and the sky above the bodies."""
    lamps = np.array([lamp.direction for lamp in lighting.lamps if lamp.shadows], np.float64).reshape(-1, 3)
    spread = np.concatenate([_disk(lamp) for lamp in lamps]) if len(lamps) else lamps
    return Shadows(_maps(surfaces, spread, _LAMP_CELLS), _maps(surfaces, _sky(lighting.sky), _SKY_CELLS))


def _disk(direction: FloatArray) -> FloatArray:
    """Directions (N, 3) spread evenly over a lamp."""
    n = np.arange(LAMP_DIRECTIONS)
    radius = np.tan(_LAMP_HALF_ANGLE) * np.sqrt((n + 0.5) / LAMP_DIRECTIONS)
    turn = n * np.pi * (3.0 - np.sqrt(5.0))
    towards, side, across = _frame(direction)
    spread: FloatArray = radius[:, None] * (np.cos(turn)[:, None] * side + np.sin(turn)[:, None] * across)
    return towards + spread


def _frame(direction: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Unit vectors: along a direction, and two across it."""
    towards = direction / np.linalg.norm(direction)
    side = np.cross(towards, [1.0, 0.0, 0.0] if abs(towards[0]) < 0.7 else [0.0, 1.0, 0.0])
    side /= np.linalg.norm(side)
    return towards, side, np.cross(towards, side)


def _sky(count: int) -> FloatArray:
    """Directions (N, 3) spread over the upper hemisphere, in equal shares of a cosine-weighted sky."""
    n = np.arange(count)
    height = np.sqrt(0.04 + (_SKY_TOP**2 - 0.04) * (n + 0.5) / count)
    turn = n * np.pi * (3.0 - np.sqrt(5.0))
    radius = np.sqrt(1.0 - height**2)
    return np.stack([radius * np.cos(turn), radius * np.sin(turn), height], axis=1)


def _maps(surfaces: Surfaces, directions: FloatArray, cells: int) -> Maps:
    axes = np.zeros((len(directions), 3, 3))
    depths = np.full((len(directions), cells, cells), -np.inf, np.float32)
    cell = 2 * _REACH_M / cells
    for k, direction in enumerate(directions):
        towards, side, across = _frame(direction)
        axes[k] = side, across, towards
        points = (surfaces.vertices - np.array(CENTER, np.float32)) @ axes[k].T.astype(np.float32)
        points[:, :2] = points[:, :2] / np.float32(cell) + np.float32(0.5 * cells - 0.5)
        _rasterise(points, surfaces.triangles, depths[k])
    return Maps(axes, depths, cell)


@compiled
def _rasterise(points: Array, triangles: Array, depth: Array) -> None:
    """Raise `depth` (K, K) to the triangles over each cell's centre; points (V, 3) in cells, cells, m."""
    size = depth.shape[0]
    for t in range(triangles.shape[0]):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        ax, ay, bx, by = points[a, 0], points[a, 1], points[b, 0], points[b, 1]
        cx, cy = points[c, 0], points[c, 1]
        left, right = max(np.ceil(min(ax, bx, cx)), 0), min(np.floor(max(ax, bx, cx)), size - 1)
        top, bottom = max(int(np.ceil(min(ay, by, cy))), 0), min(int(np.floor(max(ay, by, cy))), size - 1)
        if left > right or top > bottom:
            continue
        area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
        if abs(area) < 1e-9:
            continue
        ab, ac = points[b, 2] - points[a, 2], points[c, 2] - points[a, 2]
        along_x = (ab * (cy - ay) - ac * (by - ay)) / area
        along_y = (ac * (bx - ax) - ab * (cx - ax)) / area
        for j in range(top, bottom + 1):
            # Row by row, since the squares around slivers are almost empty.
            low, high = np.inf, -np.inf
            for px, py, qx, qy in ((ax, ay, bx, by), (bx, by, cx, cy), (cx, cy, ax, ay)):
                if py != qy and min(py, qy) <= j <= max(py, qy):
                    x = px + (j - py) * (qx - px) / (qy - py)
                    low, high = min(low, x), max(high, x)
            if high < low:
                continue
            value = points[a, 2] + along_y * (j - ay) - along_x * ax
            for i in range(max(int(np.ceil(low)), 0), min(int(np.floor(high)), size - 1) + 1):
                depth[j, i] = max(depth[j, i], value + along_x * i)
