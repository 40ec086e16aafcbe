"""What the pose estimator sees of a rig: cameras as stacked arrays, ready for compiled loops."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tracker.conventions import Array, FloatArray, Image
from tracker.geometry.camera import Camera


class Lenses(NamedTuple):
    """C cameras as arrays; a named tuple, which compiled functions take as it is."""

    rotation: FloatArray
    """(C, 3, 3) rotation of camera_from_world."""
    translation: FloatArray
    """(C, 3) translation of camera_from_world [m]."""
    position: FloatArray
    """(C, 3) centres in the world [m]."""
    focal: FloatArray
    """(C, 2) fx, fy [px]."""
    center: FloatArray
    """(C, 2) cx, cy [px]."""
    distortion: FloatArray
    """(C, 5) k1, k2, p1, p2, k3."""
    size: Array
    """(C, 2) int64 width, height [px]."""


def stack_lenses(cameras: Sequence[Camera]) -> Lenses:
    """The cameras' parameters, one row a camera."""
    return Lenses(
        rotation=np.ascontiguousarray([c.camera_from_world[:3, :3] for c in cameras]),
        translation=np.ascontiguousarray([c.camera_from_world[:3, 3] for c in cameras]),
        position=np.ascontiguousarray([c.position for c in cameras]),
        focal=np.array([[c.matrix[0, 0], c.matrix[1, 1]] for c in cameras]),
        center=np.array([[c.matrix[0, 2], c.matrix[1, 2]] for c in cameras]),
        distortion=np.ascontiguousarray([c.distortion for c in cameras]),
        size=np.array([[c.width, c.height] for c in cameras], dtype=np.int64),
    )


class Evidence(NamedTuple):
    """What one camera's image says, at two resolutions."""

    image: Image
    """(H, W, 3) BGR as the camera gave it."""
    labels: Image
    """(h, w) labels of the reduced image."""
    channels: Array
    """(3, 256) int32: offsets into the label table of this image's levels."""


class Box(NamedTuple):
    """The object's geometry for compiled functions."""

    half: FloatArray
    """(3,) half edge lengths [m]."""
    face_labels: Array
    """(6,) uint8 labels in the order of tracker.geometry.cuboid.FACE_NAMES."""


SEARCH_SIZE, ALIGN_SIZE = 135, 270
"""Shorter side [px] of the label maps in which the object is searched, and in which it is aligned."""


def reduced_size(width: int, height: int, shorter: int = SEARCH_SIZE) -> tuple[int, int]:
    """Size of an image reduced by a whole factor so that its shorter side comes nearest to `shorter`."""
    factor = max(1, round(min(width, height) / shorter))
    return width // factor, height // factor
