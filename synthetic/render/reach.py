"""Which share of the sky and of each lamp gets to what a view shows, by looking things up in shadow maps."""

from __future__ import annotations

import numpy as np

from synthetic.render.hits import Hits
from synthetic.render.interface import PinholeView
from synthetic.render.shadows import CENTER, LAMP_DIRECTIONS, Shadows
from synthetic.scene import Lighting
from tracker.compiled import compiled
from tracker.conventions import Array

_BLOCK_RAD = 0.0055
"""Pixels within squares of this size, below 3 mm at half a metre, share a look on the same surface."""

_SAME_SURFACE = 0.97
"""Least cosine between normals of the same surface."""

_BOUNCED = 0.15
"""Share of the sky's light that comes back from what hides it."""


def everything() -> Array:
    """The reach where nothing casts shadows."""
    return np.zeros((0, 0, 0), np.float32)


def reach_of(hits: Hits, view: PinholeView, shadows: Shadows, lighting: Lighting) -> Array:
    """Shares (h, w, 1 + lamps) float32 of the sky and of the lamps; a lamp without shadows reaches all."""
    out = np.ones((*hits.body.shape, 1 + len(lighting.lamps)), np.float32)
    lamps = np.flatnonzero([lamp.shadows for lamp in lighting.lamps]) + 1
    # Where pixels share their light those next to each other in `hits` are not so in the view.
    block = max(int(_BLOCK_RAD * view.fx), 1) if view.block == 1 else 1
    what = hits.body, hits.points, hits.normals
    _look(*what, *shadows.sky, *shadows.lamps, lamps.astype(np.int64), block, out)
    return out


@compiled
def sky_slope(nz: float) -> float:
    """Share of the ambient light on a surface with a normal of height nz: the dark table sends back less."""
    return 0.675 + 0.325 * nz


@compiled
def _look(
    body: Array,
    points: Array,
    normals: Array,
    sky_axes: Array,
    sky_depths: Array,
    sky_cell: float,
    lamp_axes: Array,
    lamp_depths: Array,
    lamp_cell: float,
    lamps: Array,
    block: int,
    out: Array,
) -> None:
    height, width = body.shape
    for j in range(height):
        for i in range(width):
            if body[j, i] < 0:
                continue
            a, b = j - j % block, i - i % block
            if (a != j or b != i) and body[a, b] == body[j, i]:
                product = 0.0
                for c in range(3):
                    product += normals[j, i, c] * normals[a, b, c]
                if product > _SAME_SURFACE:
                    for k in range(out.shape[2]):
                        out[j, i, k] = out[a, b, k]
                    continue
            px, py, pz = points[j, i, 0], points[j, i, 1], points[j, i, 2]
            nx, ny, nz = normals[j, i, 0], normals[j, i, 1], normals[j, i, 2]
            out[j, i, 0] = _sky_share(sky_axes, sky_depths, sky_cell, px, py, pz, nx, ny, nz)
            for k in range(len(lamps)):
                share = _lamp_share(lamp_axes, lamp_depths, lamp_cell, k, px, py, pz, nx, ny, nz)
                out[j, i, lamps[k]] = share


@compiled
def _sky_share(
    axes: Array,
    depths: Array,
    cell: float,
    px: float,
    py: float,
    pz: float,
    nx: float,
    ny: float,
    nz: float,
) -> float:
    """Share of the sky over a surface that nothing hides, weighted by the cosine to its normal."""
    # Off the surface by more than a cell, or it would hide the sky from itself.
    px, py, pz = px + 1.5 * cell * nx, py + 1.5 * cell * ny, pz + 1.5 * cell * nz
    seen = whole = 0.05  # where hardly any sky faces the surface, what there is comes from all around
    for k in range(depths.shape[0]):
        cosine = nx * axes[k, 2, 0] + ny * axes[k, 2, 1] + nz * axes[k, 2, 2]
        if cosine > 0:
            whole += cosine
            seen += cosine * _clear(axes, depths, cell, k, px, py, pz, 0.5 * cell)
    return _BOUNCED + (1 - _BOUNCED) * seen / whole


@compiled
def _lamp_share(
    axes: Array,
    depths: Array,
    cell: float,
    k: int,
    px: float,
    py: float,
    pz: float,
    nx: float,
    ny: float,
    nz: float,
) -> float:
    """Share of a lamp whose disk nothing hides."""
    px, py, pz = px + 1.5 * cell * nx, py + 1.5 * cell * ny, pz + 1.5 * cell * nz
    seen = 0.0
    for direction in range(k * LAMP_DIRECTIONS, (k + 1) * LAMP_DIRECTIONS):
        seen += _clear(axes, depths, cell, direction, px, py, pz, 0.5 * cell)
    return seen / LAMP_DIRECTIONS


@compiled
def _clear(
    axes: Array,
    depths: Array,
    cell: float,
    k: int,
    px: float,
    py: float,
    pz: float,
    bias: float,
) -> float:
    """Share of the four cells around a point that do not hide it; 1 outside of the map."""
    size = depths.shape[1]
    qx, qy, qz = px - CENTER[0], py - CENTER[1], pz - CENTER[2]
    x = (axes[k, 0, 0] * qx + axes[k, 0, 1] * qy + axes[k, 0, 2] * qz) / cell + 0.5 * size - 0.5
    y = (axes[k, 1, 0] * qx + axes[k, 1, 1] * qy + axes[k, 1, 2] * qz) / cell + 0.5 * size - 0.5
    z = axes[k, 2, 0] * qx + axes[k, 2, 1] * qy + axes[k, 2, 2] * qz + bias
    if not (0 <= x < size - 1 and 0 <= y < size - 1):
        return 1.0
    i, j = int(x), int(y)
    u, v = x - i, y - j
    share = 0.0
    if depths[k, j, i] <= z:
        share += (1 - u) * (1 - v)
    if depths[k, j, i + 1] <= z:
        share += u * (1 - v)
    if depths[k, j + 1, i] <= z:
        share += (1 - u) * v
    if depths[k, j + 1, i + 1] <= z:
        share += u * v
    return share
