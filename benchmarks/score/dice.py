"""Compares masks and positions of dice with the truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.optimize import linear_sum_assignment

from benchmarks.data.dice import DiceScene
from tracker.conventions import Array, FloatArray, Image
from tracker.geometry.camera import Camera
from tracker.geometry.cuboid import corners
from tracker.tasks.rearrange_dice import DIE_WIDTH, Die

RIGHT = DIE_WIDTH / 2
"""A reported die counts as a true one within so much of it [m]."""

RIM, NEAR_DICE = 2, 3
"""Distances [px] from the nearest pixel of a die: beyond the first, a pixel of the mask is false; beyond the
second, a pixel of the cross is judged."""

MIN_BLUE, BLUE_OVER_RED = 30, 1.5
"""Least level of blue, and over the level of red, of a pixel of the cross that nothing hides."""


@dataclass(frozen=True)
class View:
    """The mask of one camera's picture, in pixels."""

    true: int
    found: int
    both: int
    """Pixels of dice, of the mask, of both."""
    cross: int
    cross_taken: int
    """Blue pixels of the cross with no die near them, and those of them in the mask."""
    elsewhere: int
    """Pixels of the mask that are near no die, and not of the cross."""
    total: int
    """Of the picture."""


@dataclass(frozen=True, eq=False)
class Answer:
    """The dice reported of one scene, judged."""

    error: FloatArray
    """(D,) distance of each true die to the one that was reported for it [m]; nan: none was."""
    right: Array
    """(N,) whether each reported die is a true one."""
    probability: FloatArray
    """(N,) as stated."""


def judge_positions(true: FloatArray, dice: Sequence[Die]) -> Answer:
    """Pairs true dice at (D, 3) [m] with those reported: as many as are near enough, then the nearest."""
    found = np.array([die.position for die in dice]).reshape(-1, 3)
    distance = np.linalg.norm(true[:, None] - found, axis=2)
    # Too far costs more than all good pairs together, so that none is given up for a nearer one.
    rows, columns = linear_sum_assignment(np.where(distance <= RIGHT, distance, 1.0 + RIGHT * len(true)))
    kept = distance[rows, columns] <= RIGHT
    error, right = np.full(len(true), np.nan), np.zeros(len(found), bool)
    error[rows[kept]] = distance[rows, columns][kept]
    right[columns[kept]] = True
    return Answer(error, right, np.array([die.probability for die in dice], dtype=np.float64))


def judge_mask(mask: Image, image: Image, labels: Image, cross: Array) -> View:
    """Compares a mask with the truth; `cross` (H, W) says where one is on the table, hidden or not."""
    found, true = mask > 0, labels > 0
    distance = cv2.distanceTransform((~true).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    blue, red = (image[..., channel].astype(np.float64) for channel in (0, 2))
    seen = cross & (distance > NEAR_DICE) & (blue >= MIN_BLUE) & (blue >= BLUE_OVER_RED * red)
    # Its rim is a mixture of cross and table, and part of neither.
    around = cv2.dilate(cross.astype(np.uint8), np.ones((2 * RIM + 1, 2 * RIM + 1), np.uint8)) > 0
    count = np.count_nonzero
    return View(
        true=int(count(true)),
        found=int(count(found)),
        both=int(count(true & found)),
        cross=int(count(seen)),
        cross_taken=int(count(seen & found)),
        elsewhere=int(count(found & (distance > RIM) & ~around)),
        total=labels.size,
    )


def visible_fractions(cameras: tuple[Camera, ...], scene: DiceScene) -> FloatArray:
    """(D,) the dice's visible pixels over those that they would have alone, of all cameras together.

    A die alone is the convex hull of its corners, projected by OpenCV; its edges are too short for the lens
    to bend them.
    """
    points = scene.positions[:, None] + corners(np.full(3, DIE_WIDTH)) @ np.swapaxes(scene.rotations, 1, 2)
    alone, visible = np.zeros(len(points)), np.zeros(len(points))
    for camera, labels in zip(cameras, scene.labels, strict=True):
        turn, shift = camera.camera_from_world[:3, :3], camera.camera_from_world[:3, 3]
        pixels, _ = cv2.projectPoints(
            points.reshape(-1, 3), cv2.Rodrigues(turn)[0], shift, camera.matrix, camera.distortion
        )
        alone += [_pixels_inside(hull, labels.shape) for hull in np.float64(pixels).reshape(-1, 8, 2)]
        visible += np.bincount(labels.ravel(), minlength=len(points) + 1)[1 : len(points) + 1]
    # A label is by most of a pixel, the hull by its centre: at edges the two may differ.
    return np.asarray(np.minimum(visible / np.maximum(alone, 1), 1.0))


def _pixels_inside(points: FloatArray, shape: tuple[int, ...]) -> int:
    """Number of the image's pixels whose centres are within the convex hull of points (N, 2) [px]."""
    low = np.maximum(np.floor(points.min(axis=0)), 0).astype(int)
    high = np.minimum(np.ceil(points.max(axis=0)) + 1, shape[1::-1]).astype(int)
    if (low >= high).any():
        return 0
    centres = np.stack(np.meshgrid(np.arange(low[0], high[0]), np.arange(low[1], high[1])), axis=-1)
    outline = cv2.convexHull(points.astype(np.float32))[:, 0].astype(np.float64)
    edges = np.roll(outline, -1, axis=0) - outline
    offsets = centres[:, :, None] - outline
    side = edges[:, 0] * offsets[..., 1] - edges[:, 1] * offsets[..., 0]
    # All on one side, whichever way round OpenCV goes.
    return int(np.count_nonzero((side >= 0).all(axis=2) | (side <= 0).all(axis=2)))


def cross_pixels(camera: Camera, bars: FloatArray) -> Array:
    """(H, W) whether the ray of a pixel's centre, bent by the lens as OpenCV has it, meets the cross."""
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
