"""The surfaces of a scene as flat arrays, for the kernels that intersect pixel rays.

A rasteriser names each pixel's body and triangle; the rest of the point follows from these arrays, in
the body's own frame.
"""

import functools
import zlib
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from synthetic.scene import Mesh, PlatformScene
from tracker.conventions import Array, FloatArray

BODY_SHIFT = 24
"""A pixel's code is (body + 1) << 24 | triangle, and 0 where nothing is."""

MAX_BODIES = 255
MAX_TRIANGLES = 1 << BODY_SHIFT

_CREASE = np.cos(np.radians(35.0))
"""Cosine of the angle between normals below which triangles belong to one smooth surface."""

_WELD = 1e-6
"""Distance below which vertices are merged [m]: STL files repeat them in each triangle."""

_KEPT_MESHES = 256


@dataclass(frozen=True, eq=False)
class Surface:
    """A mesh in the form that the kernels need, in the body's frame."""

    vertices: Array
    """(V, 3) float32 [m]."""
    triangles: Array
    """(T, 3) int32 rows of `vertices`."""
    corners: Array
    """(T, 3, 3) float32 [m], the vertices of each triangle."""
    normals: Array
    """(T, 3, 3) float32 outward unit normals at the corners, smooth across edges that are not creases."""
    groups: Array
    """(T,) int32."""


class Surfaces(NamedTuple):
    """All bodies of a scene, with their rows concatenated."""

    vertices: Array
    """(V, 3) float32 [m], in the world."""
    triangles: Array
    """(T, 3) int32 rows of `vertices`."""
    first_triangle: Array
    """(B + 1,) int64: rows of body b are first_triangle[b] … first_triangle[b + 1] - 1."""
    corners: Array
    """(T, 3, 3) float32 [m], in each body's frame."""
    normals: Array
    """(T, 3, 3) float32."""
    groups: Array
    """(T,) int32."""
    first_group: Array
    """(B,) int64: first row of each body in `colors` and `labels`."""
    colors: Array
    """(G, 3) float32 linear BGR reflectance."""
    labels: Array
    """(G,) uint8."""
    coats: Array
    """(G, 2) float32, see `Body`."""
    world_from_body: FloatArray
    """(B, 4, 4)."""
    gloss: Array
    """(B,) float32."""
    texture: Array
    """(B,) float32."""
    grain_seeds: Array
    """(B,) uint32: bodies of the same name have the same grain."""
    is_object: Array
    """(B,) bool: whether it has a label."""


@functools.lru_cache(maxsize=_KEPT_MESHES)
def _surface(mesh: Mesh) -> Surface:
    triangles = np.asarray(mesh.triangles, dtype=np.int64).reshape(-1, 3)
    corners = np.asarray(mesh.vertices, dtype=np.float64)[triangles]
    return Surface(
        vertices=np.asarray(mesh.vertices, dtype=np.float32),
        triangles=triangles.astype(np.int32),
        corners=corners.astype(np.float32),
        normals=_corner_normals(corners).astype(np.float32),
        groups=np.asarray(mesh.groups, dtype=np.int32).reshape(-1),
    )


def _corner_normals(corners: FloatArray) -> FloatArray:
    """Return normals (T, 3, 3), at each corner the mean over adjacent triangles of one smooth surface."""
    areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    flat = areas / np.maximum(np.linalg.norm(areas, axis=1, keepdims=True), 1e-30)
    places = np.round(corners.reshape(-1, 3) / _WELD).astype(np.int64)
    _, vertex = np.unique(places, axis=0, return_inverse=True)
    vertex = vertex.reshape(-1)
    order = np.argsort(vertex, kind="stable")
    starts = np.searchsorted(vertex[order], np.arange(vertex.max(initial=-1) + 2))
    normals = np.repeat(flat, 3, axis=0)
    own = np.repeat(np.arange(len(flat)), 3)
    # Pair corner i of a vertex with corner i + shift of the same vertex, cyclically: this covers all pairs
    # without a loop over vertices.
    degree = np.diff(starts)
    rank = np.arange(len(order)) - starts[vertex[order]]
    sums = np.zeros((len(order), 3))
    for shift in range(int(degree.max(initial=0))):
        inside = shift < degree[vertex[order]]
        here = order[inside]
        base = starts[vertex[here]]
        there = order[base + (rank[inside] + shift) % degree[vertex[here]]]
        smooth = (flat[own[here]] * flat[own[there]]).sum(axis=1) > _CREASE
        sums[here] += np.where(smooth[:, None], areas[own[there]], 0.0)
    length = np.linalg.norm(sums, axis=1, keepdims=True)
    normals = np.where(length > 0, sums / np.maximum(length, 1e-30), normals)
    return normals.reshape(-1, 3, 3)


def surfaces_of(scene: PlatformScene) -> Surfaces:
    """Return the surfaces of all bodies of a scene, in their order."""
    bodies = scene.bodies
    surfaces = [_surface(body.mesh) for body in bodies]
    counts = [len(surface.groups) for surface in surfaces]
    if len(bodies) > MAX_BODIES or max(counts, default=0) > MAX_TRIANGLES:
        raise ValueError(
            f"scene: found {len(bodies)} bodies of up to {max(counts, default=0)} triangles, "
            f"expected at most {MAX_BODIES} of {MAX_TRIANGLES}"
        )
    starts = np.cumsum([0, *(len(surface.vertices) for surface in surfaces)])
    poses = [body.world_from_body.astype(np.float32) for body in bodies]
    vertices = [s.vertices @ pose[:3, :3].T + pose[:3, 3] for s, pose in zip(surfaces, poses, strict=True)]
    triangles = [s.triangles + start for s, start in zip(surfaces, starts[:-1], strict=True)]
    group_counts = [len(body.colors) for body in bodies]
    return Surfaces(
        vertices=_stack(vertices, (3,), np.float32),
        triangles=_stack(triangles, (3,), np.int32),
        first_triangle=np.cumsum([0, *counts]),
        corners=_stack([surface.corners for surface in surfaces], (3, 3), np.float32),
        normals=_stack([surface.normals for surface in surfaces], (3, 3), np.float32),
        groups=_stack([surface.groups for surface in surfaces], (), np.int32),
        first_group=np.cumsum([0, *group_counts])[:-1],
        colors=_stack([body.colors for body in bodies], (3,), np.float32),
        labels=_stack([np.asarray(body.labels).reshape(-1) for body in bodies], (), np.uint8),
        coats=_stack([np.asarray(body.coats) for body in bodies], (2,), np.float32),
        world_from_body=_stack([body.world_from_body[None] for body in bodies], (4, 4), np.float64),
        gloss=np.array([body.gloss for body in bodies], np.float32),
        texture=np.array([body.texture for body in bodies], np.float32),
        grain_seeds=np.array([zlib.crc32(body.name.encode()) for body in bodies], np.uint32),
        is_object=np.array([bool(np.any(body.labels)) for body in bodies], np.bool_),
    )


def _stack(parts: list[Array], shape: tuple[int, ...], dtype: type) -> Array:
    empty: Array = np.zeros((0, *shape), dtype)
    return np.ascontiguousarray(np.concatenate([empty, *parts]).astype(dtype, copy=False))
