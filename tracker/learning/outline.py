"""Where a pose puts the object's faces in a picture."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from tracker.conventions import Array, FloatArray, Image
from tracker.geometry.camera import Camera
from tracker.geometry.cuboid import FACE_CORNERS, corners, visible_faces
from tracker.objects.model import CuboidModel
from tracker.segmentation.labels import REFERENCE_SIZE

RIM = 2.0
"""What is left out along a face's borders [px at the reference size]: both sides mix there."""

AROUND = 6.0
"""What is left out around the object: its shine on the table and coloured fringes are in its colours."""

_SHIFT = 4
"""Fractional bits of OpenCV's polygon corners."""


class Outline(NamedTuple):
    """The object in one picture."""

    faces: Image
    """(H, W) label of the face that covers a pixel, 0 elsewhere and near the faces' borders."""
    around: Array
    """(H, W) bool: on the object or near it."""


def outline(model: CuboidModel, camera: Camera, rotation: FloatArray, position: FloatArray) -> Outline | None:
    """Faces of an object with rotation (3, 3) and position (3,) [m] before a camera; None: not in view."""
    pixels = camera.project(corners(model.size) @ rotation.T + position)
    shape = camera.height, camera.width
    if not np.isfinite(pixels).all() or np.abs(pixels).max() > 1e4:
        return None
    scale = min(shape) / REFERENCE_SIZE
    rim, reach = (2 * max(1, round(length * scale)) + 1 for length in (RIM, AROUND))
    faces, solid = np.zeros(shape, np.uint8), np.zeros(shape, np.uint8)
    visible = visible_faces(model.size, rotation.T @ (camera.position - position))
    for face in np.flatnonzero(visible):
        mask = np.zeros(shape, np.uint8)
        corner = np.rint(pixels[FACE_CORNERS[face]] * (1 << _SHIFT)).astype(np.int32)
        cv2.fillConvexPoly(mask, corner, 1, shift=_SHIFT)
        solid |= mask
        inner = cv2.erode(mask, _disc(rim), borderValue=0)
        faces[inner > 0] = model.face_labels[face]
    if not solid.any():
        return None
    return Outline(faces, cv2.dilate(solid, _disc(reach)) > 0)


def _disc(size: int) -> Image:
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size)), dtype=np.uint8)
