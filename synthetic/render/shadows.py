"""Shadows: the share of the light of the sky and of each lamp that reaches the visible points.

Depth maps are rendered from the lamps and from directions all over the sky. A map is perpendicular to the
direction of the light and holds, per cell, how far towards the light the scene reaches.

Maps have cells of millimetres and miss finer shade: where a box stands, its foot and the table hide the sky
from each other. Next to the line of contact lies a dark strip of ground of width w. At the distance d from
that line, the strip fills 1 − d / √(d² + w²) of the half of a point's view that faces it. This share of the
sky's light, times a strength, is removed; it is largest at the contact.
"""

from typing import NamedTuple

import numpy as np

from synthetic.render.hits import Hits
from synthetic.render.raster import PinholeView
from synthetic.render.surfaces import Surfaces
from synthetic.scene import Lighting, PlatformScene
from tracker.compiled import compiled
from tracker.conventions import Array, FloatArray

_CENTER = (0.0, 0.0, 0.08)
"""Centre of all maps [m]."""

_REACH_M = 0.34
"""Half width of a map [m]: it covers the arena and what stands in it."""

_LAMP_CELLS, _SKY_CELLS = 288, 160
_LAMP_DIRECTIONS = 7
_LAMP_HALF_ANGLE = np.radians(7.0)
"""Angular radius of lamps [rad]: shadows are sharp at the foot of a thing and soft far from it."""

_SKY_TOP = 0.92
"""Sine of the highest sky direction; the lowest is 0.2, since the walls hide lower ones anyway."""

_BLOCK_RAD = 0.0055
"""Pixels in square blocks of this angle, less than 3 mm at 0.5 m, share one shadow test per surface."""

_SAME_SURFACE = 0.97
"""Smallest cosine between normals that counts as the same surface."""

_BOUNCED = 0.15
"""Share of the sky's light that is reflected by whatever occludes it."""

_FLAT_M = 0.001
"""Largest height of paint and dust above the table [m]."""

Point = tuple[float, float, float]
"""A point in the world [m], or a direction."""


class Maps(NamedTuple):
    """Depth maps of several directions."""

    axes: Array
    """(M, 3, 3) rows: two axes across the light, one towards it."""
    depths: Array
    """(M, K, K) float32 [m] along the third axis."""
    cell: float
    """Size of a cell [m]."""


class Shadows(NamedTuple):
    """Maps of the lamps that cast shadows, _LAMP_DIRECTIONS for each in their order, and of the sky."""

    lamps: Maps
    sky: Maps


def shadows_of(surfaces: Surfaces, lighting: Lighting) -> Shadows:
    """Render the depth maps of lamps and sky for the bodies."""
    lamps = np.array([lamp.direction for lamp in lighting.lamps if lamp.shadows], np.float64).reshape(-1, 3)
    spread = np.concatenate([_disk(lamp) for lamp in lamps]) if len(lamps) else lamps
    return Shadows(_maps(surfaces, spread, _LAMP_CELLS), _maps(surfaces, _sky(lighting.sky), _SKY_CELLS))


def _disk(direction: FloatArray) -> FloatArray:
    """Return directions (N, 3) spread evenly over a lamp's disk."""
    n = np.arange(_LAMP_DIRECTIONS)
    radius = np.tan(_LAMP_HALF_ANGLE) * np.sqrt((n + 0.5) / _LAMP_DIRECTIONS)
    turn = n * np.pi * (3.0 - np.sqrt(5.0))
    towards, side, across = _frame(direction)
    spread: FloatArray = radius[:, None] * (np.cos(turn)[:, None] * side + np.sin(turn)[:, None] * across)
    return towards + spread


def _frame(direction: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return unit vectors along a direction, and two across it."""
    towards = direction / np.linalg.norm(direction)
    side = np.cross(towards, [1.0, 0.0, 0.0] if abs(towards[0]) < 0.7 else [0.0, 1.0, 0.0])
    side /= np.linalg.norm(side)
    return towards, side, np.cross(towards, side)


def _sky(count: int) -> FloatArray:
    """Return directions (N, 3) over the upper hemisphere, of equal shares in a cosine-weighted sky."""
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
        points = (surfaces.vertices - np.array(_CENTER, np.float32)) @ axes[k].T.astype(np.float32)
        points[:, :2] = points[:, :2] / np.float32(cell) + np.float32(0.5 * cells - 0.5)
        _rasterise(points, surfaces.triangles, depths[k])
    return Maps(axes, depths, cell)


@compiled
def _rasterise(points: Array, triangles: Array, depth: Array) -> None:
    """Raise `depth` (K, K) to the triangles over cell centres; points (V, 3) in [cells], [cells], [m]."""
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
            # Row by row, since the bounding boxes of slivers are almost empty.
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


def take_shadows(reach: Array, hits: Hits, view: PinholeView, shadows: Shadows, lighting: Lighting) -> None:
    """Fill, in place, the sky's and the shadow-casting lamps' shares in `reach` (h, w, 1 + lamps)."""
    lamps = np.flatnonzero([lamp.shadows for lamp in lighting.lamps]) + 1
    # If pixels share their light, neighbours in `hits` are not neighbours in the view.
    block = max(int(_BLOCK_RAD * view.fx), 1) if view.block == 1 else 1
    _look(hits, shadows, lamps.astype(np.int64), block, reach)


@compiled
def sky_slope(nz: float) -> float:
    """Return the share of ambient light for a normal of height nz; less comes from the dark table below."""
    return 0.675 + 0.325 * nz


@compiled
def _look(hits: Hits, shadows: Shadows, lamps: Array, block: int, out: Array) -> None:
    body, points, normals = hits.body, hits.points, hits.normals
    (axes, depths, cell), (lamp_axes, lamp_depths, lamp_cell) = shadows.sky, shadows.lamps
    height, width = body.shape
    a = 0
    for j in range(height):
        a, b = j if j == a + block else a, 0
        for i in range(width):
            b = i if i == b + block else b
            if body[j, i] < 0:
                continue
            if (a != j or b != i) and body[a, b] == body[j, i]:
                product = 0.0
                for c in range(3):
                    product += normals[j, i, c] * normals[a, b, c]
                if product > _SAME_SURFACE:
                    for k in range(out.shape[2]):
                        out[j, i, k] = out[a, b, k]
                    continue
            point = points[j, i, 0], points[j, i, 1], points[j, i, 2]
            normal = normals[j, i, 0], normals[j, i, 1], normals[j, i, 2]
            out[j, i, 0] = _sky_share(axes, depths, cell, point, normal)
            for k in range(len(lamps)):
                out[j, i, lamps[k]] = _lamp_share(lamp_axes, lamp_depths, lamp_cell, k, point, normal)


@compiled
def _sky_share(axes: Array, depths: Array, cell: float, point: Point, normal: Point) -> float:
    """Return the unoccluded share of the sky above a surface, weighted by the cosine to its normal."""
    seen = whole = 0.05  # where a surface faces hardly any sky, its light comes from all around
    for k in range(axes.shape[0]):
        cosine = normal[0] * axes[k, 2, 0] + normal[1] * axes[k, 2, 1] + normal[2] * axes[k, 2, 2]
        if cosine > 0:
            whole += cosine
            seen += cosine * _clear(axes, depths, cell, k, point, normal)
    return _BOUNCED + (1 - _BOUNCED) * seen / whole


@compiled
def _lamp_share(axes: Array, depths: Array, cell: float, k: int, point: Point, normal: Point) -> float:
    """Return the unoccluded share of a lamp's disk."""
    seen = 0.0
    for direction in range(k * _LAMP_DIRECTIONS, (k + 1) * _LAMP_DIRECTIONS):
        seen += _clear(axes, depths, cell, direction, point, normal)
    return seen / _LAMP_DIRECTIONS


@compiled
def _clear(axes: Array, depths: Array, cell: float, k: int, point: Point, normal: Point) -> float:
    """Return the weight of the four cells around a point that do not occlude it; 1 outside the map."""
    size, off = depths.shape[1], 1.5 * cell
    # Start more than one cell off the surface, or it would shadow itself.
    qx, qy, qz = (
        point[0] + off * normal[0] - _CENTER[0],
        point[1] + off * normal[1] - _CENTER[1],
        point[2] + off * normal[2] - _CENTER[2],
    )
    x = (axes[k, 0, 0] * qx + axes[k, 0, 1] * qy + axes[k, 0, 2] * qz) / cell + 0.5 * size - 0.5
    y = (axes[k, 1, 0] * qx + axes[k, 1, 1] * qy + axes[k, 1, 2] * qz) / cell + 0.5 * size - 0.5
    z = axes[k, 2, 0] * qx + axes[k, 2, 1] * qy + axes[k, 2, 2] * qz + 0.5 * cell
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


@compiled
def hidden(distance: float, width: float) -> float:
    """Return the share of the sky's light hidden by a dark strip of `width` at a distance [m], 1 at 0."""
    return float(1.0 - distance / np.hypot(distance, width))


def add_contact(reach: Array, hits: Hits, scene: PlatformScene) -> None:
    """Remove from the sky's share in `reach` (h, w, 1 + lamps), in place, what the scene's contact hides."""
    strength, width = scene.contact
    box = next((n for n, body in enumerate(scene.bodies) if body.faces), None)
    if box is None or strength == 0:
        return
    body = scene.bodies[box]
    pose, half = body.world_from_body, np.abs(body.mesh.vertices).max(axis=0)
    clearance = max(float(pose[2, 3] - np.abs(pose[2, :3]) @ half), 0.0)
    strength *= max(1.0 - clearance / width, 0.0)
    if strength == 0:
        return
    _darken(reach, hits, box, pose, half, strength, width)


@compiled
def _darken(
    reach: Array, hits: Hits, box: int, pose: Array, half: Array, strength: float, width: float
) -> None:
    """Remove light at the foot of a box of half edges `half` [m], and from what lies flat around it."""
    body, points = hits.body, hits.points
    for j in range(body.shape[0]):
        for i in range(body.shape[1]):
            height, square = points[j, i, 2], 0.0
            if body[j, i] == box:
                square = max(height, 0.0) ** 2
            elif body[j, i] >= 0 and height < _FLAT_M:
                x, y, z = points[j, i, 0] - pose[0, 3], points[j, i, 1] - pose[1, 3], height - pose[2, 3]
                for axis in range(3):
                    along = x * pose[0, axis] + y * pose[1, axis] + z * pose[2, axis]
                    square += max(abs(along) - half[axis], 0.0) ** 2
            else:
                continue
            reach[j, i, 0] *= 1.0 - strength * hidden(np.sqrt(square), width)
