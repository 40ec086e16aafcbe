"""Compares masks and positions of dice with the ground truth."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import pandas as pd
from scipy.optimize import linear_sum_assignment

from benchmarks.data.dice import DiceScene
from benchmarks.score.errors import placed, projected
from synthetic.world.meshes import silhouette
from tracker.conventions import Array, FloatArray, Image
from tracker.geometry.camera import Camera
from tracker.geometry.cuboid import corners
from tracker.tasks.rearrange_dice import DIE_WIDTH, Die

RIGHT = DIE_WIDTH / 2
"""Largest distance at which a reported die matches a true one [m]."""

BINS = ((0.3, 1.0), (0.05, 0.3))
"""Bins of the visible fraction: dice that ought to be found, and others. The lower end belongs to a bin,
the upper only if it is 1."""

RIM, NEAR_DICE = 2, 3
"""Distances from the nearest pixel of a die [px]: beyond the first a pixel of the mask is false, beyond the
second a pixel of the cross is judged."""

MIN_BLUE, BLUE_OVER_RED = 30, 1.5
"""Smallest blue level, and ratio of blue to red, of an unoccluded pixel of the cross."""


@dataclass(frozen=True, eq=False)
class Answer:
    """Comparison of the dice reported for one scene with the true ones."""

    error: FloatArray
    """(D,) distance of each true die from the one reported for it [m]; nan: not reported."""
    right: Array
    """(N,) whether each reported die is matched to a true one."""
    probability: FloatArray
    """(N,) stated probability of each reported die."""


def judge_positions(true: FloatArray, dice: Sequence[Die]) -> Answer:
    """Match true dice at (D, 3) [m] with reported ones: as many as possible, then the smallest distances."""
    found = np.array([die.position for die in dice]).reshape(-1, 3)
    distance = np.linalg.norm(true[:, None] - found, axis=2)
    # A match that is too far costs more than all good ones together, so no good one is given up for others.
    rows, columns = linear_sum_assignment(np.where(distance <= RIGHT, distance, 1.0 + RIGHT * len(true)))
    kept = distance[rows, columns] <= RIGHT
    error, right = np.full(len(true), np.nan), np.zeros(len(found), bool)
    error[rows[kept]] = distance[rows, columns][kept]
    right[columns[kept]] = True
    return Answer(error, right, np.array([die.probability for die in dice], dtype=np.float64))


def judge_mask(mask: Image, image: Image, labels: Image, cross: Array) -> dict[str, int]:
    """Compare the mask of an image with the truth, in pixels.

    `labels` go by the majority in each pixel. `cross` (H, W) is True where the table's cross is, occluded or
    not.

    Returns:
        `true`, `found`, `both`: pixels of dice, of the mask, of both. `cross`: unoccluded pixels of the cross
        with no die near them; `cross_taken`: those of them in the mask. `elsewhere`: pixels of the mask near
        neither a die nor the cross. `total`: pixels of the image.
    """
    found, true = mask > 0, labels > 0
    distance = cv2.distanceTransform((~true).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    blue, red = (image[..., channel].astype(np.float64) for channel in (0, 2))
    seen = cross & (distance > NEAR_DICE) & (blue >= MIN_BLUE) & (blue >= BLUE_OVER_RED * red)
    # The cross's rim mixes cross and table, and is part of neither.
    around = cv2.dilate(cross.astype(np.uint8), np.ones((2 * RIM + 1, 2 * RIM + 1), np.uint8)) > 0
    pixels = {
        "true": true,
        "found": found,
        "both": true & found,
        "cross": seen,
        "cross_taken": seen & found,
        "elsewhere": found & (distance > RIM) & ~around,
    }
    return {key: int(np.count_nonzero(where)) for key, where in pixels.items()} | {"total": labels.size}


def visible_fractions(cameras: tuple[Camera, ...], scene: DiceScene) -> FloatArray:
    """Return (D,) visible pixels of each die relative to its unoccluded ones, over all cameras together.

    An unoccluded die is the convex hull of its corners, projected by OpenCV; its edges are too short for the
    distortion to bend them.
    """
    points = placed(corners(np.full(3, DIE_WIDTH)), scene.positions, scene.rotations)
    alone, visible = np.zeros(len(points)), np.zeros(len(points))
    for camera, labels in zip(cameras, scene.labels, strict=True):
        pixels = projected(camera, points.reshape(-1, 3)).reshape(-1, 8, 2)
        alone += [np.count_nonzero(silhouette(hull, labels.shape)) for hull in pixels]
        visible += np.bincount(labels.ravel(), minlength=len(points) + 1)[1 : len(points) + 1]
    # Labels go by a pixel's majority, the hull by its centre: at edges the two may differ.
    return np.asarray(np.minimum(visible / np.maximum(alone, 1), 1.0))


def cross_pixels(camera: Camera, bars: FloatArray) -> Array:
    """Return (H, W) bool: whether the ray through a pixel's centre (OpenCV's lens model) hits the cross."""
    columns, rows = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    pixels = np.stack([columns, rows], axis=-1).reshape(-1, 1, 2).astype(np.float64)
    normal = cv2.undistortPoints(pixels, camera.matrix, camera.distortion)[:, 0]
    turn, shift = camera.camera_from_world[:3, :3], camera.camera_from_world[:3, 3]
    rays, start = np.c_[normal, np.ones(len(normal))] @ turn, -turn.T @ shift
    meets = np.zeros(len(rays), bool)
    for bar in bars:
        top = bar[2, 1]
        with np.errstate(divide="ignore", invalid="ignore"):
            length = (top - start[2]) / rays[:, 2]
            at = start[:2] + length[:, None] * rays[:, :2]
            meets |= (length > 0) & ((at >= bar[:2, 0]) & (at <= bar[:2, 1])).all(axis=1)
    return meets.reshape(camera.height, camera.width)


def overlap(name: str) -> Callable[[pd.DataFrame], float]:
    """Return a function for `iou`, `precision` or `recall` over all pixels of all views."""

    def of(views: pd.DataFrame) -> float:
        true, found, both = (float(views[key].sum()) for key in ("true", "found", "both"))
        return _share(both, {"iou": true + found - both, "precision": found, "recall": true}[name])

    return of


def taken(part: str, whole: str) -> Callable[[pd.DataFrame], float]:
    """Return a function for the share [%] of one kind of pixel in another, over all views."""
    return lambda views: (
        100 * _share(float(views[part].sum()), float(views[whole].sum())) if part in views else math.nan
    )


def brier(rows: pd.DataFrame) -> float:
    """Return the mean squared difference between stated probability and outcome."""
    return float(((rows.probability - rows.right) ** 2).mean())


def _share(part: float, whole: float) -> float:
    return part / whole if whole else math.nan
