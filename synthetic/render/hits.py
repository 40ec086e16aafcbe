"""Intersections of the rays through pixel centres with surfaces: body, colour group, point and normal."""

from typing import NamedTuple

import numpy as np

from synthetic.render.raster import PinholeView
from synthetic.render.surfaces import BODY_SHIFT, Surfaces
from tracker.compiled import compiled
from tracker.conventions import Array, Image


class Hits(NamedTuple):
    """One value per pixel of a view; points and normals are undefined where body is -1."""

    body: Array
    """(h, w) int16 number of the body, or -1."""
    row: Array
    """(h, w) int32 row of the body's colour group in `Surfaces.colors` and `labels`."""
    points: Array
    """(h, w, 3) float32 [m] in the world."""
    normals: Array
    """(h, w, 3) float32 unit normals in the world, towards the camera."""


def empty_hits(height: int, width: int) -> Hits:
    """Return hits to be filled in."""
    return Hits(
        np.full((height, width), -1, np.int16),
        np.zeros((height, width), np.int32),
        np.empty((height, width, 3), np.float32),
        np.empty((height, width, 3), np.float32),
    )


def hits_of_codes(codes: Array, view: PinholeView, surfaces: Surfaces, at: Array | None = None) -> Hits:
    """Intersect each pixel's ray with the triangle that its code names.

    With `at` (N,), indices into the flattened `codes`, only these pixels: hits of shape (1, N).
    """
    hits = empty_hits(*codes.shape) if at is None else empty_hits(1, len(at))
    if len(surfaces.groups):
        world_from_camera = np.linalg.inv(view.camera_from_world)
        lens = np.array([view.fx, view.fy, view.cx, view.cy])
        at = np.arange(codes.size) if at is None else at
        flat = Hits(*(part.reshape(len(at), *part.shape[2:]) for part in hits))
        _meet(codes, at, world_from_camera, lens, surfaces, flat)
    return hits


def shared(codes: Array, surfaces: Surfaces, block: int) -> tuple[Array, Array]:
    """Choose one pixel per colour group in each block, whose shading all its pixels of that group share.

    Returns:
        Indices (N,) of the chosen pixels in the flattened `codes`, and for each pixel (h, w) its row of them.
    """
    stands = np.empty(codes.shape, np.int32)
    at = np.empty(codes.size, np.int64)
    return at[: _share(codes, block, surfaces, at, stands)], stands


@compiled
def _row(code: int, first_triangle: Array, first_group: Array, groups: Array) -> int:
    """Return the row of the colour group of a code other than 0."""
    body = int(code >> BODY_SHIFT) - 1
    triangle = first_triangle[body] + int(code & ((1 << BODY_SHIFT) - 1))
    return int(first_group[body] + groups[triangle])


@compiled
def _share(codes: Array, block: int, surfaces: Surfaces, at: Array, stands: Array) -> int:
    height, width = codes.shape
    first_triangle, first_group, groups = surfaces.first_triangle, surfaces.first_group, surfaces.groups
    rows = np.empty((block * block, 2), np.int64)
    count = 0
    for top in range(0, height, block):
        for left in range(0, width, block):
            known = 0
            for j in range(top, min(top + block, height)):
                for i in range(left, min(left + block, width)):
                    row = _row(codes[j, i], first_triangle, first_group, groups) if codes[j, i] else -1
                    k = 0
                    while k < known and rows[k, 0] != row:
                        k += 1
                    if k == known:
                        rows[k, 0], rows[k, 1] = row, count
                        at[count] = j * width + i
                        known, count = known + 1, count + 1
                    stands[j, i] = rows[k, 1]
    return count


def labels_of_codes(codes: Array, surfaces: Surfaces) -> Image:
    """Return the label map (h, w) of codes."""
    labels = np.zeros(codes.shape, np.uint8)
    _label(codes, surfaces, labels)
    return labels


@compiled
def _label(codes: Array, surfaces: Surfaces, out: Array) -> None:
    first_triangle, first_group, groups = surfaces.first_triangle, surfaces.first_group, surfaces.groups
    labels = surfaces.labels
    for j in range(codes.shape[0]):
        for i in range(codes.shape[1]):
            if codes[j, i]:
                out[j, i] = labels[_row(codes[j, i], first_triangle, first_group, groups)]


Vector = tuple[float, float, float]
"""A vector in a body's frame."""


@compiled
def _meet(
    codes: Array, at: Array, world_from_camera: Array, lens: Array, surfaces: Surfaces, hits: Hits
) -> None:
    n, pose, corners = surfaces.normals, surfaces.world_from_body, surfaces.corners
    ex, ey, ez = world_from_camera[0, 3], world_from_camera[1, 3], world_from_camera[2, 3]
    bodies, rows, points, normals = hits.body, hits.row, hits.points, hits.normals
    width, j, first, last = codes.shape[1], 0, 0, 0
    body, t, row = 0, 0, 0
    edge = other = start = across = (0.0, 0.0, 0.0)
    for place in range(len(at)):
        if not first <= at[place] < first + width:
            j = at[place] // width
            first = j * width
        i = at[place] - first
        code = codes[j, i]
        if code == 0:
            continue
        if code != last:  # neighbours mostly show one triangle
            last, body = code, int(code >> BODY_SHIFT) - 1
            t = surfaces.first_triangle[body] + int(code & ((1 << BODY_SHIFT) - 1))
            row = surfaces.first_group[body] + surfaces.groups[t]
            away = ex - pose[body, 0, 3], ey - pose[body, 1, 3], ez - pose[body, 2, 3]
            px, py, pz = turned_back(pose, body, away)
            start = px - corners[t, 0, 0], py - corners[t, 0, 1], pz - corners[t, 0, 2]
            edge, other = _edge(corners, t, 1), _edge(corners, t, 2)
            across = _cross(start, edge)
        x, y = (i - lens[2]) / lens[0], (j - lens[3]) / lens[1]
        wx = world_from_camera[0, 0] * x + world_from_camera[0, 1] * y + world_from_camera[0, 2]
        wy = world_from_camera[1, 0] * x + world_from_camera[1, 1] * y + world_from_camera[1, 2]
        wz = world_from_camera[2, 0] * x + world_from_camera[2, 1] * y + world_from_camera[2, 2]
        u, v, reach = _barycentric(start, edge, other, across, turned_back(pose, body, (wx, wy, wz)))
        bodies[place] = body
        rows[place] = row
        points[place, 0] = ex + reach * wx
        points[place, 1] = ey + reach * wy
        points[place, 2] = ez + reach * wz
        w = 1.0 - u - v
        bx = w * n[t, 0, 0] + u * n[t, 1, 0] + v * n[t, 2, 0]
        by = w * n[t, 0, 1] + u * n[t, 1, 1] + v * n[t, 2, 1]
        bz = w * n[t, 0, 2] + u * n[t, 1, 2] + v * n[t, 2, 2]
        nx = pose[body, 0, 0] * bx + pose[body, 0, 1] * by + pose[body, 0, 2] * bz
        ny = pose[body, 1, 0] * bx + pose[body, 1, 1] * by + pose[body, 1, 2] * bz
        nz = pose[body, 2, 0] * bx + pose[body, 2, 1] * by + pose[body, 2, 2] * bz
        # Some triangles of scanned meshes are inside out: turn every normal towards the camera.
        scale = 1.0 / np.sqrt(max(nx * nx + ny * ny + nz * nz, 1e-30))
        if nx * wx + ny * wy + nz * wz > 0:
            scale = -scale
        normals[place, 0] = nx * scale
        normals[place, 1] = ny * scale
        normals[place, 2] = nz * scale


@compiled
def _barycentric(
    start: Vector, edge: Vector, other: Vector, across: Vector, ray: Vector
) -> tuple[float, float, float]:
    """Return weights of corners 1 and 2, clamped to the triangle, and distance on the ray (Möller-Trumbore).

    `start` leads from corner 0 to the eye, `edge` and `other` to corners 1 and 2; `across` is start × edge.
    A pixel's centre may be a rounding error outside the triangle that was rasterised there.
    """
    away = _cross(ray, other)
    determinant = _dot(edge, away)
    if abs(determinant) < 1e-18:  # seen edge-on: any point of it will do
        return 0.0, 0.0, -_dot(start, ray) / _dot(ray, ray)
    u, v = _dot(start, away) / determinant, _dot(ray, across) / determinant
    reach = _dot(other, across) / determinant
    u, v = min(max(u, 0.0), 1.0), min(max(v, 0.0), 1.0)
    if u + v > 1.0:
        u, v = u / (u + v), v / (u + v)
    return u, v, reach


@compiled
def _dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@compiled
def _cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@compiled
def turned_back(pose: Array, body: int, vector: Vector) -> Vector:
    """Rotate a direction from the world into a body's frame."""
    x, y, z = vector
    return (
        pose[body, 0, 0] * x + pose[body, 1, 0] * y + pose[body, 2, 0] * z,
        pose[body, 0, 1] * x + pose[body, 1, 1] * y + pose[body, 2, 1] * z,
        pose[body, 0, 2] * x + pose[body, 1, 2] * y + pose[body, 2, 2] * z,
    )


@compiled
def _edge(corners: Array, t: int, k: int) -> Vector:
    """Return the edge from a triangle's corner 0 to its corner k."""
    return (
        float(corners[t, k, 0] - corners[t, 0, 0]),
        float(corners[t, k, 1] - corners[t, 0, 1]),
        float(corners[t, k, 2] - corners[t, 0, 2]),
    )
