"""How far from its axis a camera sees: far beyond, the lens model folds points back into the image."""

from __future__ import annotations

import functools

import numpy as np
import numpy.typing as npt

from tracker.conventions import FloatArray
from tracker.geometry.camera import Camera

MARGIN = 1.2
"""Points are projected up to so many times the largest tangent of the image's rays."""


@functools.lru_cache(maxsize=64)
def largest_tangent(camera: Camera) -> float:
    """Largest tangent of the angle between the optical axis and the rays of the image's border."""
    columns, rows = (np.linspace(-0.5, count - 0.5, 9) for count in (camera.width, camera.height))
    pixels = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    tangents = np.linalg.norm(camera.undistort(pixels), axis=1)
    return float(tangents[np.isfinite(tangents)].max(initial=0.0))


def project_in_view(camera: Camera, points_world: npt.ArrayLike) -> FloatArray:
    """Pixels (N, 2) of world points (N, 3) [m]; NaN behind the camera and far beyond its field of view."""
    points = np.asarray(points_world, dtype=np.float64).reshape(-1, 3)
    in_camera = points @ camera.camera_from_world[:3, :3].T + camera.camera_from_world[:3, 3]
    tangent = np.hypot(in_camera[:, 0], in_camera[:, 1])
    seen = tangent < MARGIN * largest_tangent(camera) * in_camera[:, 2]
    pixels: FloatArray
    if seen.all():
        return camera.project(points)
    pixels = np.full((len(points), 2), np.nan)
    pixels[seen] = camera.project(points[seen])
    return pixels
