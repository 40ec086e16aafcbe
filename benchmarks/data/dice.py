"""Scenes of the dice task that are judged: the pictures, and where every die is."""

from __future__ import annotations

import functools
import io
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from benchmarks.data import scenes
from benchmarks.data.scenes import SIZE
from benchmarks.data.store import CACHE, Store, fingerprint, read_packed
from synthetic.frames import Frame, FrameMaker, FrameOptions
from tracker.conventions import Array, FloatArray, Image
from tracker.geometry.camera import Camera
from tracker.geometry.cuboid import corners
from tracker.tasks.rearrange_dice import DIE_WIDTH

KINDS = {"thrown": "dice_thrown", "laid": "dice_goal"}
"""thrown: as physics lets them fall. laid: on cells of the task's grid."""

SEED = scenes.SEED + 10 * len(scenes.OBJECTS)
"""Of the first kind, the next one's is one more. Like the seed it comes from, for nothing else."""


@dataclass(frozen=True, eq=False)
class DiceScene:
    """One picture of each camera, and the truth."""

    index: int
    """Number in its stream."""
    images: tuple[Image, ...]
    """(H, W, 3) uint8 BGR."""
    labels: tuple[Image, ...]
    """(H, W) uint8, what most of a pixel shows: 0 other, k + 1 die k."""
    positions: FloatArray
    """(D, 3) of the dice's centres [m]."""
    rotations: FloatArray
    """(D, 3, 3) world from die."""
    bars: FloatArray
    """(B, 3, 2) least and greatest x, y, z [m] of the bars of the cross on the table; B = 0: none."""

    def packed(self) -> bytes:
        """The scene as the content of an npz file."""
        buffer = io.BytesIO()
        np.savez_compressed(
            buffer,
            index=self.index,
            images=np.stack(self.images),
            labels=np.stack(self.labels),
            positions=self.positions,
            rotations=self.rotations,
            bars=self.bars,
        )
        return buffer.getvalue()

    @classmethod
    def unpacked(cls, content: bytes) -> DiceScene:
        """The scene that `packed` wrote.

        Raises:
            ValueError, KeyError, OSError, zipfile.BadZipFile: the content is something else.
        """
        with np.load(io.BytesIO(content), allow_pickle=False) as data:
            return cls(
                int(data["index"]),
                tuple(data["images"]),
                tuple(data["labels"]),
                data["positions"],
                data["rotations"],
                data["bars"],
            )


def dice_store(kind: str, seed: int = SEED, workers: int = 2, folder: Path = CACHE) -> Store[DiceScene]:
    """The scenes of one of KINDS, by their numbers.

    Args:
        kind: thrown or laid.
        seed: of the first kind; another one than SEED for all but judging.
        workers: number of processes that render what is missing.
        folder: where scenes are kept.
    """
    own = seed + list(KINDS).index(kind)
    return Store(
        f"dice, {kind}",
        folder / f"dice-{kind}-{SIZE}-{own}-{fingerprint('benchmarks/data/dice.py')}",
        functools.partial(_maker, kind, own),
        functools.partial(read_packed, unpacked=DiceScene.unpacked),
        workers,
    )


def _maker(kind: str, seed: int) -> Callable[[int], DiceScene]:
    frames = FrameMaker(FrameOptions("dice", seed, size=SIZE, empty=0.0, kind=KINDS[kind]))

    def make(index: int) -> DiceScene:
        (frame,) = frames.chunk(index)
        return _scene_of(frame)

    return make


def _scene_of(frame: Frame) -> DiceScene:
    bars = []
    for body in frame.scene.bodies:
        if body.name.startswith("cross_"):
            world = body.mesh.vertices @ body.world_from_body[:3, :3].T + body.world_from_body[:3, 3]
            bars.append(np.stack([world.min(axis=0), world.max(axis=0)], axis=1))
    return DiceScene(
        frame.index,
        frame.images,
        frame.labels,
        np.array([state.position for state in frame.objects]),
        np.array([state.rotation for state in frame.objects]),
        np.array(bars).reshape(-1, 3, 2),
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
