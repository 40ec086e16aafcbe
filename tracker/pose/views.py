"""What the pose estimator sees of a rig: cameras as stacked arrays, ready for compiled loops."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tracker.conventions import Array, FloatArray, Image
from tracker.geometry.camera import Camera

LENS = np.dtype(
    [
        ("rotation", np.float64, (3, 3)),  # of camera_from_world
        ("translation", np.float64, (3,)),  # of camera_from_world [m]
        ("position", np.float64, (3,)),  # the camera's centre in the world [m]
        ("focal", np.float64, (2,)),  # fx, fy [px]
        ("center", np.float64, (2,)),  # cx, cy [px]
        ("distortion", np.float64, (5,)),  # k1, k2, p1, p2, k3
        ("width", np.int64),  # [px]
        ("height", np.int64),  # [px]
    ]
)
"""A camera as a record: compiled functions read its fields without counting references to arrays."""


def stack_lenses(cameras: Sequence[Camera]) -> Array:
    """The cameras as an array (C,) of LENS records."""
    lenses = np.zeros(len(cameras), LENS)
    for lens, camera in zip(lenses, cameras, strict=True):
        lens["rotation"] = camera.camera_from_world[:3, :3]
        lens["translation"] = camera.camera_from_world[:3, 3]
        lens["position"] = camera.position
        lens["focal"] = camera.matrix[0, 0], camera.matrix[1, 1]
        lens["center"] = camera.matrix[0, 2], camera.matrix[1, 2]
        lens["distortion"] = camera.distortion
        lens["width"], lens["height"] = camera.width, camera.height
    return lenses


class Evidence(NamedTuple):
    """What one camera's image says, at two resolutions."""

    image: Image
    """(H, W, 3) BGR as the camera gave it."""
    labels: Image
    """(h, w) labels of the reduced image."""
    channels: Array
    """(3, 256) int32: offsets into the label table of this image's levels."""
    mosaic: int = -1
    """Which pixels measured red, if each measured one colour only (`segmentation.mosaic.find`); or -1."""


class Box(NamedTuple):
    """The object's geometry for compiled functions."""

    half: FloatArray
    """(3,) half edge lengths [m]."""
    face_labels: Array
    """(6,) uint8 labels in the order of tracker.geometry.cuboid.FACE_NAMES."""


SEARCH_SIZE = 135
"""Shorter side [px] of the label maps in which the object is searched and aligned."""


def reduced_size(width: int, height: int, shorter: int = SEARCH_SIZE) -> tuple[int, int]:
    """Size of an image reduced by a whole factor so that its shorter side comes nearest to `shorter`."""
    factor = max(1, round(min(width, height) / shorter))
    return width // factor, height // factor
