"""Meshes: simple solids, and files of triangles [m]."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh

from synthetic.scene import Mesh
from tracker.conventions import Array, FloatArray
from tracker.geometry.cuboid import FACE_CORNERS, corners


def box(key: str, size: Array, *, one_group: bool = False) -> Mesh:
    """A cuboid of edge lengths `size` (3,) [m] about the origin.

    Its groups are the faces in the order of `geometry.cuboid.FACE_NAMES`; `one_group`: all are group 0.
    """
    # Four vertices a face: the renderers' smooth shading must not reach across edges.
    vertices = corners(size)[FACE_CORNERS].reshape(-1, 3)
    first = 4 * np.arange(6)[:, None]
    triangles = (first[:, :, None] + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3)
    groups = np.zeros(12, dtype=np.int64) if one_group else np.repeat(np.arange(6), 2)
    return Mesh(key, vertices, triangles, groups)


def disc(key: str, radius: float, segments: int = 96) -> Mesh:
    """A flat disc that faces +z, about the origin; `radius` [m]."""
    angle = 2 * np.pi * np.arange(segments) / segments
    rim = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros(segments)], axis=1)
    index = np.arange(segments)
    triangles = np.stack([np.zeros_like(index), 1 + index, 1 + (index + 1) % segments], axis=1)
    return Mesh(key, np.vstack([np.zeros((1, 3)), rim]), triangles, np.zeros(segments, dtype=np.int64))


def cylinder(radius: float, length: float) -> tuple[FloatArray, Array]:
    """Vertices and triangles of a cylinder along z about the origin [m]."""
    solid = trimesh.creation.cylinder(radius=radius, height=length, sections=24)
    # Caps and side get vertices of their own, for the sake of smooth shading.
    side = np.abs(solid.face_normals[:, 2]) < 0.5
    parts = [(solid.vertices, solid.faces[side]), (solid.vertices, solid.faces[~side])]
    return concatenate(parts)


def load(path: Path, scale: Array | None = None) -> tuple[FloatArray, Array]:
    """Vertices (V, 3) [m] and triangles (T, 3) of a mesh file, equal vertices merged."""
    solid = trimesh.load_mesh(path)
    vertices = np.asarray(solid.vertices, dtype=np.float64)
    return vertices * (1.0 if scale is None else np.asarray(scale)), np.asarray(solid.faces, dtype=np.int64)


def concatenate(parts: list[tuple[FloatArray, Array]]) -> tuple[FloatArray, Array]:
    """One set of vertices and triangles from several."""
    offsets = np.cumsum([0] + [len(vertices) for vertices, _ in parts[:-1]])
    triangles = [indices + offset for (_, indices), offset in zip(parts, offsets, strict=True)]
    return np.vstack([vertices for vertices, _ in parts]), np.vstack(triangles)


def coils(inner: float, outer: float, height: float) -> tuple[FloatArray, Array]:
    """Strips around x at x = `height`, facing +x: a motor's windings seen between its six spokes [m]."""
    parts = []
    slots = 36
    for k in range(slots):
        if k % 6 == 0:  # behind a spoke
            continue
        middle, half = 2 * np.pi * k / slots, 0.27 * 2 * np.pi / slots
        angles = middle + np.array([-half, half])
        rim = np.stack([np.cos(angles), np.sin(angles)], axis=1)
        ring = np.vstack([inner * rim, outer * rim])
        parts.append((np.column_stack([np.full(4, height), ring]), np.array([[0, 2, 3], [0, 3, 1]])))
    return concatenate(parts)
