"""PyBullet's TinyRenderer, where no OpenGL is to be had: slower, with the same shading and the same labels.

It tells a pixel's body and depth. On bodies of few flat faces the point and its normal come from the faces
themselves, on round ones from the depths of neighbouring pixels.
"""

from __future__ import annotations

import itertools

import numpy as np

from synthetic.render.hits import Hits, barycentric, empty_hits, labels_of_hits, nearness_of_hits
from synthetic.render.interface import Layers, PinholeView
from synthetic.render.light import SceneLight
from synthetic.render.surfaces import Surfaces, SurfaceStore
from synthetic.render.tiny_codes import Stage
from synthetic.scene import PlatformScene
from tracker.compiled import compiled
from tracker.conventions import Array, FloatArray

_FEW_TRIANGLES = 64
"""Of one colour group of a body with flat faces."""


class TinyRenderer:
    """Renderer over PyBullet, in two worlds of its own: everything, and the objects alone."""

    name = "tiny"

    def __init__(self) -> None:
        self._all, self._objects = Stage(), Stage()
        self._store = SurfaceStore()
        self._light = SceneLight()

    def render(self, scene: PlatformScene, view: PinholeView, *, shadows: bool = True) -> Layers:
        """What `view` shows of `scene`."""
        surfaces = self._store.of_scene(scene)
        bodies = list(enumerate(scene.bodies))
        body, group, depth = self._all.paint(view, bodies)
        hits = empty_hits(view.height, view.width)
        hits.body[:] = body
        hits.row[:] = _rows(body, group, surfaces)
        _meet_by_depth(hits, depth, view, surfaces)
        body, group, _ = self._objects.paint(view, [row for row in bodies if surfaces.is_object[row[0]]])
        alone = labels_of_hits(hits._replace(body=body, row=_rows(body, group, surfaces)), surfaces)
        color = self._light.shade(scene, hits, view, surfaces, shadows=shadows)
        return Layers(color, labels_of_hits(hits, surfaces), alone, nearness_of_hits(hits, view))

    def close(self) -> None:
        """Delete the worlds."""
        self._all.close()
        self._objects.close()


def _rows(body: Array, group: Array, surfaces: Surfaces) -> Array:
    if not len(surfaces.first_group):
        return np.zeros(body.shape, np.int32)
    return np.where(body >= 0, surfaces.first_group[body] + group, 0).astype(np.int32)


def _meet_by_depth(hits: Hits, depth: FloatArray, view: PinholeView, surfaces: Surfaces) -> None:
    """Fill in points and normals."""
    if not len(surfaces.groups):
        return
    world_from_camera = np.linalg.inv(view.camera_from_world)
    columns, rows = np.meshgrid(
        (np.arange(view.width) - view.cx) / view.fx, (np.arange(view.height) - view.cy) / view.fy
    )
    rays = np.stack([columns, rows, np.ones_like(rows)], axis=-1) @ world_from_camera[:3, :3].T
    eye = np.ascontiguousarray(world_from_camera[:3, 3])
    hits.points[:] = eye + rays * depth[..., None]
    few = _have_few_triangles(surfaces)
    _slopes(hits, rays, depth)
    tables = surfaces.first_triangle, surfaces.first_group, surfaces.groups, surfaces.corners
    _flat_faces(hits, rays, eye, few, *tables, surfaces.world_from_body)


def _have_few_triangles(surfaces: Surfaces) -> Array:
    """(B,) bool: bodies whose points and normals come from their triangles, colour group by colour group."""
    bodies = itertools.pairwise(surfaces.first_triangle)
    most = [np.bincount(surfaces.groups[first:end]).max(initial=0) for first, end in bodies]
    return np.array(most) <= _FEW_TRIANGLES


@compiled
def _slopes(hits: Hits, rays: Array, depth: Array) -> None:
    """Normals from the points of the neighbours of the same body, on the side of less change of depth."""
    height, width = depth.shape
    for j in range(height):
        for i in range(width):
            if hits.body[j, i] < 0:
                continue
            steps = np.zeros((2, 3))
            for axis in range(2):
                best = np.inf
                for sign in (-1, 1):
                    y, x = j + (sign if axis else 0), i + (0 if axis else sign)
                    if not (0 <= y < height and 0 <= x < width) or hits.body[y, x] != hits.body[j, i]:
                        continue
                    change = abs(depth[y, x] - depth[j, i])
                    if change < best:
                        best = change
                        for c in range(3):
                            there, here = depth[y, x] * rays[y, x, c], depth[j, i] * rays[j, i, c]
                            steps[axis, c] = sign * (there - here)
            a, b = steps[0], steps[1]
            _store_normal(
                hits,
                j,
                i,
                rays[j, i],
                a[1] * b[2] - a[2] * b[1],
                a[2] * b[0] - a[0] * b[2],
                a[0] * b[1] - a[1] * b[0],
            )


@compiled
def _flat_faces(
    hits: Hits,
    rays: Array,
    eye: Array,
    few: Array,
    first: Array,
    first_group: Array,
    groups: Array,
    corners: Array,
    world_from_body: Array,
) -> None:
    """Exact points and normals on bodies of few triangles: of the pixel's group, the nearest one it meets."""
    for j in range(rays.shape[0]):
        for i in range(rays.shape[1]):
            body = hits.body[j, i]
            if body < 0 or not few[body]:
                continue
            group = hits.row[j, i] - first_group[body]
            ray, pose = rays[j, i], world_from_body[body]
            best, miss, chosen = np.inf, np.inf, -1
            for t in range(first[body], first[body + 1]):
                if groups[t] != group:
                    continue
                _, _, reach, outside = barycentric(
                    corners, t, world_from_body, body, eye, ray[0], ray[1], ray[2]
                )
                # Just outside counts as a hit: the rasteriser rounds otherwise.
                if max(outside, 0.02) < miss or (outside <= max(miss, 0.02) and reach < best):
                    best, miss, chosen = reach, max(outside, 0.02), t
            if chosen < 0:
                continue
            a, b, c = corners[chosen, 0], corners[chosen, 1], corners[chosen, 2]
            e, f = b - a, c - a
            bx, by, bz = e[1] * f[2] - e[2] * f[1], e[2] * f[0] - e[0] * f[2], e[0] * f[1] - e[1] * f[0]
            for k in range(3):
                hits.points[j, i, k] = eye[k] + best * ray[k]
            _store_normal(
                hits,
                j,
                i,
                ray,
                pose[0, 0] * bx + pose[0, 1] * by + pose[0, 2] * bz,
                pose[1, 0] * bx + pose[1, 1] * by + pose[1, 2] * bz,
                pose[2, 0] * bx + pose[2, 1] * by + pose[2, 2] * bz,
            )


@compiled
def _store_normal(hits: Hits, j: int, i: int, ray: Array, nx: float, ny: float, nz: float) -> None:
    """Keep a normal of any length and sign as a unit vector towards the camera."""
    length = np.sqrt(nx * nx + ny * ny + nz * nz)
    if length == 0.0:  # no neighbour: it faces the camera
        nx, ny, nz = ray[0], ray[1], ray[2]
        length = np.sqrt(nx * nx + ny * ny + nz * nz)
    scale = 1.0 / length if nx * ray[0] + ny * ray[1] + nz * ray[2] < 0 else -1.0 / length
    hits.normals[j, i, 0] = nx * scale
    hits.normals[j, i, 1] = ny * scale
    hits.normals[j, i, 2] = nz * scale
