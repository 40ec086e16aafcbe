"""The views side by side at a readable size, each with its camera's name."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import cv2
import numpy as np

from tracker.calibration.rig import CameraRig
from tracker.checks import check_sequence, of_kind
from tracker.conventions import Image
from tracker.errors import ImageError
from tracker.geometry.camera import Camera
from tracker.viz import paint

MIN_HEIGHT = 400
"""Images are scaled by the smallest whole number that makes them at least this high [px]."""

GAP = 6
"""Between panels [px]."""

_NAME_SIZE = 14.0
_EMPTY = (44, 38, 35)

Draw = Callable[[int, Image, Camera], None]
"""Draws into the panel of the camera of this index; the camera given is that of the scaled image."""


def panels(images: Sequence[Image | None], rig: CameraRig, draw: Draw) -> Image:
    """A row of all views.

    Args:
        images: (H, W, 3) uint8 BGR of each camera of the rig; None: the panel says that there is none.
        rig: the cameras.
        draw: called for each image there is.

    Raises:
        ImageError: the images do not fit the rig.
    """
    of_kind(rig, CameraRig, "overlay: rig", ImageError, "tracker.CameraRig.load")
    check_sequence(images, "overlay: images", ImageError)
    if len(images) != len(rig):
        raise ImageError(
            f"overlay: found {len(images)} images, expected one of each of {', '.join(rig.names)}"
        )
    height = max(camera.height * -(-MIN_HEIGHT // camera.height) for camera in rig)
    parts: list[Image] = []
    for index, (image, camera) in enumerate(zip(images, rig, strict=True)):
        if parts:
            parts.append(np.full((height, GAP, 3), paint.BACKGROUND, np.uint8))
        size = (max(1, round(camera.width * height / camera.height)), height)
        if image is None:
            panel = _empty_panel(*size)
        else:
            panel = _scaled(image, camera, size)
            draw(index, panel, camera.resized(*size))
        _draw_name(panel, camera.name)
        parts.append(panel)
    return np.concatenate(parts, axis=1)


def _empty_panel(width: int, height: int) -> Image:
    panel: Image = np.full((height, width, 3), _EMPTY, np.uint8)
    paint.put_text(panel, "no image", (width / 2, height / 2), paint.FAINT, size=18, align=0.5)
    return panel


def _scaled(image: Image, camera: Camera, size: tuple[int, int]) -> Image:
    expected = (camera.height, camera.width, 3)
    of_kind(image, np.ndarray, f"overlay: {camera.name}", ImageError)
    if image.shape != expected or image.dtype != np.uint8:
        found = f"{image.dtype} {image.shape}"
        raise ImageError(f"overlay: {camera.name}: found an image {found}, expected uint8 {expected}")
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_CUBIC), dtype=np.uint8)


def _draw_name(panel: Image, name: str) -> None:
    left, top, right, bottom = 12, 12, 36 + paint.text_width(name, _NAME_SIZE), 26 + 1.7 * _NAME_SIZE
    corners = np.array([(left, top), (right, top), (right, bottom), (left, bottom)], dtype=np.float64)
    paint.fill(panel, corners, paint.BACKGROUND, 0.6)
    paint.put_text(panel, name, (24, (top + bottom + _NAME_SIZE) / 2), paint.BRIGHT, size=_NAME_SIZE)
