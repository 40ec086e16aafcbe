"""The predecessor's method, as it is described in public, for comparison.

Differential evolution (a population of 40 over 50 generations) searches position and rotation vector. Its
cost looks at 150 pixels that are drawn from the colours' masks: the square root of a pixel's distance outside
the projected outline of its colour's face, and a penalty for faces that point away from the camera. Where to
search: the masks' centres give a ray each, and the box around their nearest point is searched.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.optimize import differential_evolution

import tracker
from benchmarks.metrics import projected
from tracker.conventions import Array, FloatArray, Image
from tracker.geometry import so3
from tracker.geometry.camera import Camera
from tracker.geometry.cuboid import FACE_CORNERS, FACE_NORMALS, corners
from tracker.segmentation.color_model import ColorModel

POPULATION, GENERATIONS, PIXELS = 40, 50, 150

REACH = np.array([0.08, 0.08, 0.05])
"""Half the sides of the box in which the position is searched [m]."""

AWAY = 5.0
"""Cost of a pixel whose face points away, and per unit of the cosine by which it does."""


@dataclass(frozen=True, eq=False)
class _View:
    """One camera's share of the sampled pixels."""

    camera: Camera
    pixels: FloatArray
    """(S, 2) [px]."""
    faces: Array
    """(S,) the face that has the pixel's colour."""


def find(
    model: tracker.CuboidModel,
    cameras: Sequence[Camera],
    images: Sequence[Image | None],
    colors: ColorModel,
    seed: int,
) -> tuple[FloatArray, FloatArray] | None:
    """Position (3,) [m] and rotation (3, 3) world from object; None where no colour is found.

    Args:
        model: the object.
        cameras: in the order of the images.
        images: (H, W, 3) uint8 BGR, None where a camera gives none.
        colors: of the object's faces.
        seed: of sampling and search.
    """
    rng = np.random.default_rng(seed)
    views = _views(model, cameras, images, colors, rng)
    if not views:
        return None
    center = _nearest_to_rays(views)
    low = np.concatenate([center - REACH, np.full(3, -np.pi)])
    high = np.concatenate([center + REACH, np.full(3, np.pi)])
    half = float(np.min(model.size)) / 2
    # The object is above the table.
    low[2], high[2] = max(low[2], half), max(high[2], half + REACH[2])
    result = differential_evolution(
        lambda x: cost(x.T, views, model.size),
        np.c_[low, high],
        init=rng.uniform(low, high, (POPULATION, 6)),
        maxiter=GENERATIONS,
        tol=0.0,
        polish=False,
        vectorized=True,
        updating="deferred",
        rng=rng,
    )
    return result.x[:3], so3.exp(result.x[3:])


def _views(
    model: tracker.CuboidModel,
    cameras: Sequence[Camera],
    images: Sequence[Image | None],
    colors: ColorModel,
    rng: np.random.Generator,
) -> list[_View]:
    face_of = np.zeros(7, dtype=np.int64)
    face_of[model.face_labels] = np.arange(6)
    found = []
    for camera, image in zip(cameras, images, strict=True):
        if image is not None:
            labels = tracker.segment(image, colors)
            rows, columns = np.nonzero(labels)
            found.append((camera, np.c_[columns, rows].astype(float), face_of[labels[rows, columns]]))
    total = sum(len(pixels) for _, pixels, _ in found)
    if total == 0:
        return []
    chosen = np.zeros(total, dtype=bool)
    chosen[rng.choice(total, min(PIXELS, total), replace=False)] = True
    views, start = [], 0
    for camera, pixels, faces in found:
        own = chosen[start : start + len(pixels)]
        start += len(pixels)
        if own.any():
            views.append(_View(camera, pixels[own], faces[own]))
    return views


def _nearest_to_rays(views: Sequence[_View]) -> FloatArray:
    """The point (3,) [m] nearest to the rays through the middle of each view's pixels.

    One ray alone leaves the depth open: the plane at half the arena's usual height decides.
    """
    matrix, vector = np.zeros((3, 3)), np.zeros(3)
    for view in views:
        camera = view.camera
        middle = cv2.undistortPoints(view.pixels.mean(axis=0)[None], camera.matrix, camera.distortion)[0, 0]
        ray = camera.camera_from_world[:3, :3].T @ np.array([*middle, 1.0])
        across = np.eye(3) - np.outer(ray, ray) / (ray @ ray)
        matrix += across
        vector += across @ camera.position
    # A weak pull to a height of 4 cm: it decides where there is one ray only.
    matrix[2, 2] += 1e-3
    vector[2] += 1e-3 * 0.04
    return np.asarray(np.linalg.solve(matrix, vector))


def cost(parameters: Array, views: Sequence[_View], size: Array) -> FloatArray:
    """Mean cost (P,) of poses (P, 6), position [m] and rotation vector [rad]."""
    positions, rotations = parameters[:, :3], so3.exp(parameters[:, 3:])
    points = corners(np.asarray(size)) @ np.swapaxes(rotations, -1, -2) + positions[:, None]
    normals = FACE_NORMALS @ np.swapaxes(rotations, -1, -2)
    centers = positions[:, None] + normals * np.repeat(np.asarray(size) / 2, 2)[:, None]
    total, count = np.zeros(len(parameters)), 0
    for view in views:
        toward = view.camera.position - centers
        cosine = (normals * toward).sum(axis=-1) / np.linalg.norm(toward, axis=-1)
        pixels = projected(view.camera, points.reshape(-1, 3)).reshape(-1, 8, 2)
        outside = outside_distance(pixels[:, FACE_CORNERS[view.faces]], view.pixels)
        away = np.clip(-cosine[:, view.faces], 0, None)
        total += (np.sqrt(outside) + np.where(away > 0, AWAY * (1 + away), 0)).sum(axis=1)
        count += len(view.pixels)
    return total / max(count, 1)


def outside_distance(polygons: Array, points: Array) -> FloatArray:
    """Distance (..., S) [px] of points (S, 2) to convex polygons (..., S, K, 2); 0 inside of them."""
    start, end = polygons, np.roll(polygons, -1, axis=-2)
    along, offset = end - start, points[:, None] - start
    length = np.maximum((along**2).sum(axis=-1), 1e-12)
    share = np.clip((along * offset).sum(axis=-1) / length, 0, 1)
    apart = np.linalg.norm(offset - share[..., None] * along, axis=-1).min(axis=-1)
    side = along[..., 0] * offset[..., 1] - along[..., 1] * offset[..., 0]
    inside = (side >= 0).all(axis=-1) | (side <= 0).all(axis=-1)
    return np.where(inside, 0.0, apart)
