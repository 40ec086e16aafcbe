"""Compiled light: how bright and of what colour a point of the scene is.

`w`, `c`, `m` (Any) are records of `records.ROOM`, `CAPSULE`, `MOTOR`; points are in the world's frame [m];
colours are linear BGR.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from tracker.compiled import compiled
from tracker.conventions import Array

Color = tuple[float, float, float]
"""Blue, green, red."""

NOTHING, TABLE, RING, CROSS, WALL_OUTSIDE = 0, 1, 2, 3, 4
FIRST_WALL, FIRST_FACE, FIRST_MOTOR, FIRST_CAPSULE = 5, 20, 30, 60
"""Codes of what a ray meets; to the FIRST ones the number of the wall's section, face and so on is added."""

MAP_EXTENT = 0.2
"""The shadow map covers the table's square -MAP_EXTENT ... MAP_EXTENT [m]."""

BLACK = 0.012
"""Least radiance of a surface: nothing is quite black."""

DARKNESS = 0.03
"""Radiance of what is outside the arena."""

_SPOKES = 9


@compiled
def _random(i: int, j: int, seed: int) -> float:
    """Repeatable noise in -1 ... 1 of a lattice point."""
    h = (i * 374761393 + j * 668265263 + seed * 974711) & 0xFFFFFFFF
    h = ((h ^ (h >> 13)) * 1274126177) & 0xFFFFFFFF
    h = ((h ^ (h >> 16)) * 668265263) & 0xFFFFFFFF
    return (h >> 8) / 8388607.5 - 1.0


@compiled
def _grain(u: float, v: Any, cell: float, seed: int) -> float:
    """Smooth noise in -1 ... 1 with features of the size `cell` [m] in surface coordinates u, v [m]."""
    u, v = u / cell, v / cell
    i, j = int(np.floor(u)), int(np.floor(v))
    u, v = u - i, v - j
    u, v = u * u * (3.0 - 2.0 * u), v * v * (3.0 - 2.0 * v)
    near = (1.0 - u) * _random(i, j, seed) + u * _random(i + 1, j, seed)
    far = (1.0 - u) * _random(i, j + 1, seed) + u * _random(i + 1, j + 1, seed)
    mixed: float = (1.0 - v) * near + v * far
    return mixed


@compiled
def _lambert(w: Any, nx: float, ny: float, nz: float) -> float:
    """0 facing away from the lamp ... 1 towards it; the room is bright, so it falls off slowly."""
    cosine: float = nx * w.light[0] + ny * w.light[1] + nz * w.light[2]
    return 0.5 * (1.0 + cosine)


@compiled
def _lit(lit: Array, x: float, y: float) -> float:
    """Share of the lamp that reaches (x, y) on the table: bilinear in the shadow map."""
    cells = lit.shape[0]
    u = min(max((x / MAP_EXTENT + 1.0) / 2.0 * cells - 0.5, 0.0), cells - 1.001)
    v = min(max((y / MAP_EXTENT + 1.0) / 2.0 * cells - 0.5, 0.0), cells - 1.001)
    i, j = int(u), int(v)
    u, v = u - i, v - j
    near = (1.0 - u) * lit[j, i] + u * lit[j, i + 1]
    far = (1.0 - u) * lit[j + 1, i] + u * lit[j + 1, i + 1]
    mixed: float = (1.0 - v) * near + v * far
    return mixed


@compiled
def _table_brightness(w: Any, blotches: Array, lit: Array, x: float, y: float) -> float:
    brightness: float = 1.0 - w.shadow * (1.0 - _lit(lit, x, y))
    brightness *= 1.0 + 0.4 * (w.light[0] * x + w.light[1] * y) / MAP_EXTENT
    brightness *= 1.0 + 0.05 * _grain(x, y, 0.045, w.seed) + 0.02 * _grain(x, y, 0.004, w.seed + 1)
    for n in range(len(blotches)):
        distance2 = (x - blotches[n, 0]) ** 2 + (y - blotches[n, 1]) ** 2
        brightness *= 1.0 + blotches[n, 3] * np.exp(-0.5 * distance2 / blotches[n, 2] ** 2)
    return brightness


@compiled
def _wall_brightness(w: Any, section: int, x: float, y: float, z: float) -> float:
    radius = np.sqrt(x * x + y * y)
    rise = w.wall_heights[section + 1] - w.wall_heights[section]
    run = w.wall_radii[section + 1] - w.wall_radii[section]
    norm = np.sqrt(rise * rise + run * run)
    inward = -rise / norm / radius
    brightness: float = 0.75 + 0.5 * _lambert(w, x * inward, y * inward, run / norm)
    # The foot of the wall sees less of the room.
    brightness *= 1.0 - 0.35 * np.exp(-z / 0.03)
    brightness *= 1.0 + 0.04 * _grain(x + z, y - z, 0.06, w.seed + 2)
    return brightness


@compiled
def _face_brightness(w: Any, face: int, x: float, y: float, z: float) -> float:
    axis, sign = face // 2, 1.0 - 2.0 * (face % 2)
    x, y, z = x - w.position[0], y - w.position[1], z - w.position[2]
    nx, ny, nz = sign * w.rotation[0, axis], sign * w.rotation[1, axis], sign * w.rotation[2, axis]
    b, c = (axis + 1) % 3, (axis + 2) % 3
    u = w.rotation[0, b] * x + w.rotation[1, b] * y + w.rotation[2, b] * z
    v = w.rotation[0, c] * x + w.rotation[1, c] * y + w.rotation[2, c] * z
    seed = w.seed + 10 + 2 * face
    grain = _grain(u, v, 0.03, seed) + 0.7 * _grain(u, v, 0.003, seed + 1)
    brightness: float = (0.6 + 0.6 * _lambert(w, nx, ny, nz)) * (1.0 + w.dirt * grain)
    return brightness


@compiled
def _capsule_brightness(w: Any, c: Any, share: float, x: float, y: float, z: float) -> float:
    x -= c.start[0] + share * (c.end[0] - c.start[0])
    y -= c.start[1] + share * (c.end[1] - c.start[1])
    z -= c.start[2] + share * (c.end[2] - c.start[2])
    norm = np.sqrt(x * x + y * y + z * z)
    brightness: float = 0.55 + 0.6 * _lambert(w, x / norm, y / norm, z / norm)
    return brightness


@compiled
def _spoke_brightness(m: Any, x: float, y: float, z: float) -> float:
    """0 on the motor's dark parts, else the brightness of copper."""
    nx, ny, nz = m.normal[0], m.normal[1], m.normal[2]
    # Two axes in the disc, by way of a world axis that is well off its normal.
    ux, uy, uz = (0.0, nz, -ny) if abs(nx) < 0.6 else (-nz, 0.0, nx)
    norm = np.sqrt(ux * ux + uy * uy + uz * uz)
    vx, vy, vz = ny * uz - nz * uy, nz * ux - nx * uz, nx * uy - ny * ux
    x, y, z = x - m.center[0], y - m.center[1], z - m.center[2]
    u, v = (ux * x + uy * y + uz * z) / norm, (vx * x + vy * y + vz * z) / norm
    distance, wave = np.sqrt(u * u + v * v) / m.radius, np.sin(_SPOKES * np.arctan2(v, u))
    if distance < 0.35 or distance > 0.85 or wave < -0.1:
        return 0.0
    brightness: float = 0.5 + 0.6 * max(wave, 0.0)
    return brightness


@compiled
def _color(brightness: float, albedo: Array) -> Color:
    blue, green, red = brightness * albedo[0], brightness * albedo[1], brightness * albedo[2]
    return max(blue, BLACK), max(green, BLACK), max(red, BLACK)


@compiled
def shade(
    w: Any,
    capsules: Array,
    motors: Array,
    blotches: Array,
    lit: Array,
    code: int,
    share: float,
    x: float,
    y: float,
    z: float,
) -> Any:
    """Color (blue, green, red) of the point that a ray met; `share` is where along a capsule's axis."""
    if code in (NOTHING, WALL_OUTSIDE):
        return DARKNESS, DARKNESS, DARKNESS
    if code < FIRST_WALL:
        brightness = _table_brightness(w, blotches, lit, x, y)
        if code == CROSS:
            return _color(brightness, w.cross_albedo)
        return _color(brightness * (0.6 if code == RING else 1.0), w.table_albedo)
    if code < FIRST_FACE:
        return _color(_wall_brightness(w, code - FIRST_WALL, x, y, z), w.wall_albedo)
    if code < FIRST_MOTOR:
        face = code - FIRST_FACE
        return _color(_face_brightness(w, face, x, y, z), w.face_albedos[face])
    if code < FIRST_CAPSULE:
        m = motors[code - FIRST_MOTOR]
        return _color(_spoke_brightness(m, x, y, z), m.albedo)
    c = capsules[code - FIRST_CAPSULE]
    return _color(_capsule_brightness(w, c, share, x, y, z), c.albedo)
