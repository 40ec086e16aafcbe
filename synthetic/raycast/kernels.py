"""Compiled rays: what a ray meets, and the mean of what it brings back over a pixel.

A ray is its origin and unit direction in the world's frame, six scalars: kernels allocate nothing per ray.
`w`, `c`, `m`, `v` (Any) are records of `records.ROOM`, `CAPSULE`, `MOTOR`, `VIEW`: unlike arrays they are
passed without counting references, which would take most of the time. What a ray meets is a code of
`shading`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from synthetic.raycast.shading import (
    CROSS,
    FIRST_CAPSULE,
    FIRST_FACE,
    FIRST_MOTOR,
    FIRST_WALL,
    MAP_EXTENT,
    NOTHING,
    RING,
    TABLE,
    WALL_OUTSIDE,
    Color,
    shade,
)
from tracker.compiled import compiled
from tracker.conventions import Array

if TYPE_CHECKING:
    from synthetic.raycast.records import World

_BELOW = -1e-4
"""Shadow rays start this far below the table [m], so that what stands on it blocks them."""


@compiled
def _hit_box(w: Any, ox: float, oy: float, oz: float, dx: float, dy: float, dz: float) -> tuple[float, int]:
    """Distance and face where a ray enters the object, or infinity."""
    near, far, face = -np.inf, np.inf, -1
    px, py, pz = ox - w.position[0], oy - w.position[1], oz - w.position[2]
    for axis in range(3):
        rx, ry, rz = w.rotation[0, axis], w.rotation[1, axis], w.rotation[2, axis]
        origin, slope = rx * px + ry * py + rz * pz, rx * dx + ry * dy + rz * dz
        if slope == 0.0:
            if abs(origin) > w.half[axis]:
                return np.inf, -1
            continue
        center, reach = -origin / slope, w.half[axis] / abs(slope)
        if center - reach > near:
            near = center - reach
            face = 2 * axis + (0 if slope < 0 else 1)
        far = min(far, center + reach)
    if near <= far and near > 0:
        return near, face
    return np.inf, -1


@compiled
def _hit_sphere(product: float, square: float, radius: float) -> float:
    """Distance at which a ray enters a sphere; `product` and `square` of its origin minus the centre."""
    h = product * product - square + radius * radius
    if h < 0:
        return np.inf
    t = -product - np.sqrt(h)
    return t if t > 0 else np.inf


@compiled
def _hit_capsule(
    c: Any, ox: float, oy: float, oz: float, dx: float, dy: float, dz: float
) -> tuple[float, float]:
    """Distance at which a ray enters a capsule, and the share of the axis where that surface belongs."""
    ra, rb = c.radii[0], c.radii[1]
    ax, ay, az = ox - c.start[0], oy - c.start[1], oz - c.start[2]
    bx = c.end[0] - c.start[0]
    by = c.end[1] - c.start[1]
    bz = c.end[2] - c.start[2]
    length2, taper = bx * bx + by * by + bz * bz, ra - rb
    ba, bd = bx * ax + by * ay + bz * az, bx * dx + by * dy + bz * dz
    da, aa = dx * ax + dy * ay + dz * az, ax * ax + ay * ay + az * az

    best, share = np.inf, 0.0
    side2 = length2 - taper * taper
    if side2 > 0:
        # The cone that touches both spheres: k2 t² + 2 k1 t + k0 = 0, valid between the circles of contact.
        k2 = side2 - bd * bd
        k1 = side2 * da - ba * bd + bd * taper * ra
        k0 = side2 * aa - ba * ba + 2.0 * ba * taper * ra - length2 * ra * ra
        h = k1 * k1 - k0 * k2
        if h < 0 and k0 > 0:
            return best, share
        root = np.sqrt(max(h, 0.0))
        for t in ((-k1 - root) / k2, (-k1 + root) / k2):
            y = ba - ra * taper + t * bd
            if h >= 0 and 0 < t < best and 0 < y < side2:
                best, share = t, y / side2
    t = _hit_sphere(da, aa, ra)
    if t < best:
        best, share = t, 0.0
    t = _hit_sphere(da - bd, aa - 2.0 * ba + length2, rb)
    if t < best:
        best, share = t, 1.0
    return best, share


@compiled
def _hit_motor(m: Any, ox: float, oy: float, oz: float, dx: float, dy: float, dz: float) -> float:
    nx, ny, nz = m.normal[0], m.normal[1], m.normal[2]
    px, py, pz = m.center[0] - ox, m.center[1] - oy, m.center[2] - oz
    t: float = (nx * px + ny * py + nz * pz) / (nx * dx + ny * dy + nz * dz)
    qx, qy, qz = t * dx - px, t * dy - py, t * dz - pz
    if t > 0 and qx * qx + qy * qy + qz * qz < m.radius * m.radius:
        return t
    return np.inf


@compiled
def _hit_background(
    w: Any, ox: float, oy: float, oz: float, dx: float, dy: float, dz: float
) -> tuple[float, int]:
    """Distance and code of table, wall or nothing."""
    best, code = np.inf, NOTHING
    for k in range(len(w.wall_radii) - 1):
        z0, z1 = w.wall_heights[k], w.wall_heights[k + 1]
        slope = (w.wall_radii[k + 1] - w.wall_radii[k]) / (z1 - z0)
        # x² + y² = (r + slope (z - z0))² along the ray.
        r, s = w.wall_radii[k] + slope * (oz - z0), slope * dz
        a = dx * dx + dy * dy - s * s
        b = dx * ox + dy * oy - s * r
        h = b * b - a * (ox * ox + oy * oy - r * r)
        root = np.sqrt(max(h, 0.0))
        for t in ((-b - root) / a, (-b + root) / a):
            z = oz + t * dz
            if h >= 0 and 0 < t < best and z0 <= z <= z1 and r + t * s > 0:
                inward = dx * (ox + t * dx) + dy * (oy + t * dy) > slope * dz * (r + t * s)
                best, code = t, FIRST_WALL + k if inward else WALL_OUTSIDE
    t = -oz / dz
    if 0 < t < best:
        x, y = ox + t * dx, oy + t * dy
        radius = np.sqrt(x * x + y * y)
        if radius < w.table_radius:
            width, length = w.cross[0] / 2, w.cross[1] / 2
            crossed = (abs(x) < width and abs(y) < length) or (abs(y) < width and abs(x) < length)
            best, code = t, CROSS if crossed else TABLE
        elif radius < w.wall_radii[0]:
            best, code = t, RING
    return best, code


@compiled
def _trace(
    w: Any, capsules: Array, motors: Array, ox: float, oy: float, oz: float, dx: float, dy: float, dz: float
) -> tuple[float, int, float, bool]:
    """Distance, code, share (see `_hit_capsule`), and whether the object were seen without the fingers."""
    best, code = _hit_background(w, ox, oy, oz, dx, dy, dz)
    share, bare = 0.0, False
    if w.present:
        t, face = _hit_box(w, ox, oy, oz, dx, dy, dz)
        if t < best:
            best, code, bare = t, FIRST_FACE + face, True
    for c in range(len(capsules)):
        t, where = _hit_capsule(capsules[c], ox, oy, oz, dx, dy, dz)
        if t < best:
            best, code, share = t, FIRST_CAPSULE + c, where
    for m in range(len(motors)):
        t = _hit_motor(motors[m], ox, oy, oz, dx, dy, dz)
        if t < best:
            best, code = t, FIRST_MOTOR + m
    return best, code, share, bare


@compiled
def _is_blocked(
    w: Any, capsules: Array, ox: float, oy: float, oz: float, dx: float, dy: float, dz: float
) -> bool:
    if w.present and _hit_box(w, ox, oy, oz, dx, dy, dz)[0] < np.inf:
        return True
    c = 0
    while c < len(capsules) and _hit_capsule(capsules[c], ox, oy, oz, dx, dy, dz)[0] == np.inf:
        c += 1
    return c < len(capsules)


@compiled
def shadow_map(world: World, lamps: Array, cells: int) -> Array:
    """Share (cells, cells) of the lamps' directions (N, 3) that a point of the table sees; rows along y."""
    w, capsules = world.room[0], world.capsules
    lit = np.ones((cells, cells))
    for row in range(cells):
        y = ((row + 0.5) / cells * 2 - 1) * MAP_EXTENT
        for column in range(cells):
            x = ((column + 0.5) / cells * 2 - 1) * MAP_EXTENT
            blocked = 0
            for n in range(len(lamps)):
                blocked += _is_blocked(w, capsules, x, y, _BELOW, lamps[n, 0], lamps[n, 1], lamps[n, 2])
            lit[row, column] = 1.0 - blocked / len(lamps)
    return lit


@compiled
def _look(
    w: Any, v: Any, capsules: Array, motors: Array, blotches: Array, lit: Array, x: float, y: float
) -> tuple[int, bool, Color]:
    """Code, bare (see `_trace`) and colour along the ray of normalised camera coordinates (x, y)."""
    dx = v.rotation[0, 0] * x + v.rotation[0, 1] * y + v.rotation[0, 2]
    dy = v.rotation[1, 0] * x + v.rotation[1, 1] * y + v.rotation[1, 2]
    dz = v.rotation[2, 0] * x + v.rotation[2, 1] * y + v.rotation[2, 2]
    scale = 1.0 / np.sqrt(dx * dx + dy * dy + dz * dz)
    dx, dy, dz = dx * scale, dy * scale, dz * scale
    ox, oy, oz = v.eye[0], v.eye[1], v.eye[2]
    t, code, share, bare = _trace(w, capsules, motors, ox, oy, oz, dx, dy, dz)
    color = shade(w, capsules, motors, blotches, lit, code, share, ox + t * dx, oy + t * dy, oz + t * dz)
    return code, bare, color


@compiled
def _surroundings(codes: Array, j: int, i: int) -> tuple[bool, bool]:
    """Whether a pixel needs more than one ray, and whether the object is near it."""
    edge, near_object = FIRST_MOTOR <= codes[j, i] < FIRST_CAPSULE, False
    for row in range(max(j - 1, 0), min(j + 2, codes.shape[0])):
        for column in range(max(i - 1, 0), min(i + 2, codes.shape[1])):
            edge |= codes[row, column] != codes[j, i]
            near_object |= FIRST_FACE <= codes[row, column] < FIRST_MOTOR
    return edge, near_object


@compiled
def trace_image(
    world: World, view: Array, nodes: Array, many: Array, few: Array
) -> tuple[Array, Array, Array, Array]:
    """Mean radiance (H, W, 3), code at the centre (H, W), `bare` there, and the object's coverage (H, W).

    Args:
        world: a `records.World`.
        view: (1,) of `records.VIEW`.
        nodes: (2H + 1, 2W + 1, 2) normalised coordinates at the pixels' centres, corners and between.
        many: (N, 9) weights of a pixel's 3 × 3 nodes for each ray through a pixel on an edge of the object.
        few: (M, 9) the same for other edges.
    """
    w, v = world.room[0], view[0]
    capsules, motors, blotches, lit = world.capsules, world.motors, world.blotches, world.lit
    height, width = nodes.shape[0] // 2, nodes.shape[1] // 2
    radiance = np.empty((height, width, 3), np.float32)
    codes = np.empty((height, width), np.int32)
    bare = np.empty((height, width), np.bool_)
    coverage = np.empty((height, width), np.float32)
    for j in range(height):
        for i in range(width):
            x, y = nodes[2 * j + 1, 2 * i + 1, 0], nodes[2 * j + 1, 2 * i + 1, 1]
            codes[j, i], bare[j, i], color = _look(w, v, capsules, motors, blotches, lit, x, y)
            radiance[j, i, 0], radiance[j, i, 1], radiance[j, i, 2] = color
            coverage[j, i] = FIRST_FACE <= codes[j, i] < FIRST_MOTOR
    for j in range(height):
        for i in range(width):
            edge, near_object = _surroundings(codes, j, i)
            if not edge:
                continue
            weights = many if near_object else few
            blue, green, red, hits = 0.0, 0.0, 0.0, 0
            for n in range(len(weights)):
                x, y = 0.0, 0.0
                for k in range(9):
                    x += weights[n, k] * nodes[2 * j + k // 3, 2 * i + k % 3, 0]
                    y += weights[n, k] * nodes[2 * j + k // 3, 2 * i + k % 3, 1]
                code, _, color = _look(w, v, capsules, motors, blotches, lit, x, y)
                blue, green, red = blue + color[0], green + color[1], red + color[2]
                hits += FIRST_FACE <= code < FIRST_MOTOR
            radiance[j, i, 0] = blue / len(weights)
            radiance[j, i, 1] = green / len(weights)
            radiance[j, i, 2] = red / len(weights)
            coverage[j, i] = hits / len(weights)
    return radiance, codes, bare, coverage
