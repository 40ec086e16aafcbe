"""The object's edges that an image shows, found from the truth: one sample for each pixel of length."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from benchmarks.score.errors import projected
from tracker.conventions import Array, FloatArray, Image
from tracker.geometry import so3
from tracker.geometry.camera import Camera
from tracker.geometry.cuboid import EDGES, corners, face_centers, visible_faces
from tracker.objects.model import CuboidModel

BESIDE = 1.3
"""Distance from the edge [px] at which the labels of both sides are looked at: beyond a pixel's corner."""

STEP = 1e-5
"""Of the numerical derivatives [m, rad]."""


@dataclass(frozen=True, eq=False)
class EdgeSamples:
    """Samples along one visible edge in one image."""

    pixels: FloatArray
    """(N, 2) where the edge is [px]."""
    normals: FloatArray
    """(N, 2) unit vectors across it, out of the face."""
    visible: Array
    """(N,) bool: whether the image shows the edge here."""
    jacobian: FloatArray
    """(N, 6) how far it moves along the normal with the pose, (δp, δθ) along world axes [px/m, px/rad]."""
    by_camera: FloatArray
    """(N, 6) the same with camera_from_world, (δt, ω) as in [exp(ω) R | t + δt]."""


def edge_samples(
    camera: Camera, model: CuboidModel, labels: Image, position: Array, rotation: FloatArray
) -> list[EdgeSamples]:
    """The edges of a cuboid at its true pose that the camera sees at least in part.

    An edge counts as seen where the label map (H, W) has the face's label on its side and the background
    or the other visible face on the other; so it is not where a finger covers it.
    """
    seen = visible_faces(model.size, rotation.T @ (camera.position - position))
    points = corners(np.asarray(model.size))
    result = []
    for a, b, f, g in EDGES:
        if not (seen[f] or seen[g]):
            continue
        inner, outer = (f, g) if seen[f] else (g, f)
        ends = points[[a, b]]
        length = np.linalg.norm(np.diff(projected(camera, ends @ rotation.T + position), axis=0))
        count = int(length)
        if count < 1:
            continue
        share = (np.arange(count) + 0.5)[:, None] / count
        local = ends[0] + share * (ends[1] - ends[0])
        own = _along(camera, model, (local, ends[1] - ends[0], int(inner)), position, rotation)
        beyond = int(model.face_labels[outer]) if seen[outer] else 0
        sides = (
            _label(labels, own.pixels - BESIDE * own.normals),
            _label(labels, own.pixels + BESIDE * own.normals),
        )
        shown = (sides[0] == model.face_labels[inner]) & (sides[1] == beyond)
        if shown.any():
            result.append(EdgeSamples(own.pixels, own.normals, shown, own.jacobian, own.by_camera))
    return result


def _along(
    camera: Camera,
    model: CuboidModel,
    edge: tuple[FloatArray, FloatArray, int],
    position: Array,
    rotation: FloatArray,
) -> EdgeSamples:
    local, direction, face = edge

    def place(x: FloatArray) -> FloatArray:
        return projected(camera, local @ (so3.exp(x[3:]) @ rotation).T + position + x[:3])

    def seen_from(x: FloatArray) -> FloatArray:
        turn, shift = camera.camera_from_world[:3, :3], camera.camera_from_world[:3, 3]
        world = local @ rotation.T + position
        moved = (world @ turn.T) @ so3.exp(x[3:]).T + shift + x[:3]
        # Back into the world of the camera as it is, whose projection then applies.
        return projected(camera, (moved - shift) @ turn)

    pixels = place(np.zeros(6))
    step = 1e-3 * direction
    tangent = projected(camera, (local + step) @ rotation.T + position) - pixels
    normals = np.stack([tangent[:, 1], -tangent[:, 0]], axis=1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    middle = face_centers(np.asarray(model.size))[face]
    inward = projected(camera, (middle @ rotation.T + position)[None]) - pixels
    normals *= np.where((normals * inward).sum(axis=1, keepdims=True) > 0, -1.0, 1.0)
    return EdgeSamples(
        pixels,
        normals,
        np.ones(len(pixels), bool),
        np.einsum("nik,ni->nk", derivative(place), normals),
        np.einsum("nik,ni->nk", derivative(seen_from), normals),
    )


def derivative(function: Callable[[FloatArray], FloatArray]) -> FloatArray:
    """(..., 6) central differences at zero of a function of (6,)."""
    columns = [(function(step) - function(-step)) / (2 * STEP) for step in STEP * np.eye(6)]
    return np.stack(columns, axis=-1)


def _label(labels: Image, pixels: FloatArray) -> Array:
    column, row = np.rint(pixels).astype(int).T
    height, width = labels.shape
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    found = np.full(len(pixels), 255)
    found[inside] = labels[row[inside], column[inside]]
    return found
