"""Meshes: simple solids, and mesh files [m]."""

import functools
from pathlib import Path

import cv2
import numpy as np

from synthetic.scene import Mesh
from tracker.conventions import Array, FloatArray
from tracker.geometry.cuboid import FACE_CORNERS, corners
from tracker.processes import uninterrupted

with uninterrupted():  # it would take an interrupt for a missing package of its own
    import trimesh

_PIP_CORNERS = 12
"""Corners of the polygon that approximates a pip, about two pixels wide in an image; a multiple of 4."""

_DIAGONAL, _SQUARE = {(0, 0), (2, 2)}, {(0, 0), (0, 2), (2, 0), (2, 2)}
_PIPS = {
    1: {(1, 1)},
    2: _DIAGONAL,
    3: _DIAGONAL | {(1, 1)},
    4: _SQUARE,
    5: _SQUARE | {(1, 1)},
    6: _SQUARE | {(0, 1), (2, 1)},
}
"""Cells with a pip in a face's 3 × 3 cells, by the face's number."""


QUAD = np.array([[0, 1, 2], [0, 2, 3]])
"""Triangles of a rectangle's four corners."""


def fan(count: int) -> Array:
    """Return triangles (N, 3) of a polygon of `count` points that is star-shaped about its first point."""
    return np.array([[0, k, k + 1] for k in range(1, count - 1)])


def circle(angle: Array) -> FloatArray:
    """Return points (N, 2) of the unit circle at angles (N,) [rad]."""
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


def box(size: Array, *, one_group: bool = False) -> Mesh:
    """Return a cuboid of edge lengths `size` (3,) [m] about the origin.

    Its groups are the faces in the order of `geometry.cuboid.FACE_NAMES`; `one_group`: all are group 0.
    """
    # Four vertices per face, since the renderers' smooth shading must not reach across edges.
    vertices = corners(size)[FACE_CORNERS].reshape(-1, 3)
    first = 4 * np.arange(6)[:, None]
    triangles = (first[:, :, None] + QUAD).reshape(-1, 3)
    groups = np.zeros(12, dtype=np.int64) if one_group else np.repeat(np.arange(6), 2)
    return Mesh(f"box_{np.asarray(size).tobytes().hex()}_{one_group}", vertices, triangles, groups)


def die(size: float, spread: float, diameter: float) -> Mesh:
    """Return a die of edge length `size` [m] about the origin with pips: 1 on +x, 2 on +y, 3 on +z.

    Args:
        size: edge length [m].
        spread: distance of the outer rows of pips from the centre of a face [m].
        diameter: diameter of the pips [m], at most 0.9 `spread`; they are polygons of the circle's area.

    Returns:
        Mesh with the pips as group 1 and the rest as group 0.
    """
    rows = np.array([-spread, 0.0, spread])
    lines = np.array([-size / 2, -spread / 2, spread / 2, size / 2])
    grid = np.stack(np.meshgrid(lines, lines, indexing="ij"), axis=-1)
    parts, groups = [], []
    for axis, sign, pips in [(k, sign, pips) for k in range(3) for sign, pips in ((1, k + 1), (-1, 6 - k))]:
        for i, j in np.ndindex(3, 3):
            cell = np.stack([grid[i, j], grid[i + 1, j], grid[i + 1, j + 1], grid[i, j + 1]])
            if (i, j) in _PIPS[pips]:
                flat, triangles, is_pip = _cell_with_pip(cell, np.array([rows[i], rows[j]]), diameter)
            else:
                flat, triangles, is_pip = cell, QUAD, np.zeros(2, dtype=np.int64)
            vertices = np.zeros((len(flat), 3))
            vertices[:, axis] = sign * size / 2
            vertices[:, [(axis + 1) % 3, (axis + 2) % 3]] = flat
            parts.append((vertices, triangles[:, ::sign]))
            groups.append(is_pip)
    return Mesh(f"die_{size}_{spread}_{diameter}", *concatenate(parts), np.concatenate(groups))


def _cell_with_pip(cell: FloatArray, center: FloatArray, diameter: float) -> tuple[FloatArray, Array, Array]:
    """Return flat vertices (V, 2) [m], triangles and groups of a rectangle (4, 2) around a pip.

    The rectangle's sides have vertices at its corners only, so that neighbours meet in whole edges.
    """
    n = _PIP_CORNERS
    radius = diameter / 2 * np.sqrt(2 * np.pi / n / np.sin(2 * np.pi / n))
    rim = center + radius * circle(2 * np.pi * np.arange(n) / n)
    k = np.arange(n)
    # The cell's corners start between the directions -u and -v, the rim at +u: half a turn apart.
    corner = n + (k * 4 // n + 2) % 4
    inside = np.stack([np.zeros(n - 2, dtype=np.int64), k[1:-1], k[2:]], axis=1)
    around = np.stack([corner, (k + 1) % n, k], axis=1)
    start = k[:: n // 4]
    between = np.stack([start, corner[start - 1], corner[start]], axis=1)
    triangles = np.concatenate([inside, around, between])
    return np.concatenate([rim, cell]), triangles, (np.arange(len(triangles)) < n - 2).astype(np.int64)


def disc(radius: float) -> Mesh:
    """Return a flat disc of `radius` [m] about the origin that faces +z."""
    segments = 96
    angle = 2 * np.pi * np.arange(segments) / segments
    rim = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros(segments)], axis=1)
    index = np.arange(segments)
    triangles = np.stack([np.zeros_like(index), 1 + index, 1 + (index + 1) % segments], axis=1)
    return Mesh(
        f"disc_{radius}", np.vstack([np.zeros((1, 3)), rim]), triangles, np.zeros(segments, dtype=np.int64)
    )


def cylinder(radius: float, length: float) -> tuple[FloatArray, Array]:
    """Return vertices and triangles of a cylinder along z about the origin [m]."""
    solid = trimesh.creation.cylinder(radius=radius, height=length, sections=24)
    # Caps and side have separate vertices, for smooth shading.
    side = np.abs(solid.face_normals[:, 2]) < 0.5
    parts = [(solid.vertices, solid.faces[side]), (solid.vertices, solid.faces[~side])]
    return concatenate(parts)


def tube(line: FloatArray, radius: float, sides: int = 10) -> tuple[FloatArray, Array]:
    """Return a tube with closed ends around the points (N, 3) of a line [m]."""
    ways = np.gradient(line, axis=0)
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    helper = np.eye(3)[int(np.argmin(np.abs(ways).max(axis=0)))]
    side = np.cross(ways, helper)
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    angle = 2 * np.pi * np.arange(sides)[:, None, None] / sides
    rings = line + radius * (np.cos(angle) * side + np.sin(angle) * np.cross(ways, side))
    vertices = rings.transpose(1, 0, 2).reshape(-1, 3)
    k = np.arange(sides)
    following, last = (k + 1) % sides, len(line) - 1
    first = np.stack([k, following, sides + following], axis=1)
    second = np.stack([k, sides + following, sides + k], axis=1)
    walls = [np.concatenate([first, second]) + sides * n for n in range(last)]
    cap = np.stack([np.zeros_like(k[2:]), k[2:], k[1:-1]], axis=1)
    return vertices, np.concatenate([*walls, cap, cap[:, ::-1] + sides * last])


def load(path: Path, scale: Array | None = None) -> tuple[FloatArray, Array]:
    """Return vertices (V, 3) [m] and triangles (T, 3) of a mesh file, with equal vertices merged."""
    vertices, triangles = _loaded(path)
    return vertices * (1.0 if scale is None else np.asarray(scale)), triangles


@functools.lru_cache(maxsize=16)
def _loaded(path: Path) -> tuple[FloatArray, Array]:
    solid = trimesh.load_mesh(path)
    result = np.array(solid.vertices, dtype=np.float64), np.array(solid.faces, dtype=np.int64)
    for array in result:
        array.flags.writeable = False
    return result


def concatenate(parts: list[tuple[FloatArray, Array]]) -> tuple[FloatArray, Array]:
    """Concatenate sets of vertices and triangles."""
    offsets = np.cumsum([0] + [len(vertices) for vertices, _ in parts[:-1]])
    triangles = [indices + offset for (_, indices), offset in zip(parts, offsets, strict=True)]
    return np.vstack([vertices for vertices, _ in parts]), np.vstack(triangles)


def coils(inner: float, outer: float, height: float) -> tuple[FloatArray, Array]:
    """Return strips around x at x = `height`, facing +x: a motor's windings between its six spokes [m]."""
    parts = []
    slots = 36
    for k in range(slots):
        if k % 6 == 0:  # behind a spoke
            continue
        middle, half = 2 * np.pi * k / slots, 0.27 * 2 * np.pi / slots
        rim = circle(middle + np.array([-half, half]))
        ring = np.vstack([inner * rim, outer * rim])
        parts.append((np.column_stack([np.full(4, height), ring]), np.array([[0, 2, 3], [0, 3, 1]])))
    return concatenate(parts)


def silhouette(points: FloatArray, shape: tuple[int, ...]) -> Array:
    """Return the mask (H, W) of pixels whose centres are within the convex hull of points (N, 2) [px]."""
    mask = np.zeros(shape, bool)
    low = np.maximum(np.floor(points.min(axis=0)), 0).astype(int)
    high = np.minimum(np.ceil(points.max(axis=0)) + 1, shape[1::-1]).astype(int)
    if (low >= high).any():
        return mask
    centres = np.stack(np.meshgrid(np.arange(low[0], high[0]), np.arange(low[1], high[1])), axis=-1)
    outline = cv2.convexHull(points.astype(np.float32))[:, 0].astype(np.float64)
    edges = np.roll(outline, -1, axis=0) - outline
    offsets = centres[:, :, None] - outline
    side = edges[:, 0] * offsets[..., 1] - edges[:, 1] * offsets[..., 0]
    # Inside: on the same side of all edges, whatever the orientation of OpenCV's hull.
    mask[low[1] : high[1], low[0] : high[0]] = (side >= 0).all(axis=2) | (side <= 0).all(axis=2)
    return mask
