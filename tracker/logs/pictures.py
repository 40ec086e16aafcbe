"""Pictures as recordings hold them: raw Bayer pixels, or PNG and JPEG whose integrity is checked.

OpenCV fills what is missing of a damaged picture with grey and says so on stderr only; hence the checks.
"""

from __future__ import annotations

import cv2
import numpy as np

from tracker.conventions import Image
from tracker.errors import LogError
from tracker.files.encoded import check, stated_size
from tracker.logs.log import MAX_SIDE, MIN_SIDE


def from_bayer(raw: Image) -> Image:
    """BGR image (H, W, 3) of raw pixels (H, W), red at even rows and columns."""
    # OpenCV names the pattern after the second row's second and third pixel.
    return np.asarray(cv2.cvtColor(raw, cv2.COLOR_BAYER_BG2BGR), dtype=np.uint8)


def to_bayer(image: Image) -> Image:
    """Raw pixels (H, W) as a sensor under the same mosaic measures them, of a BGR image (H, W, 3)."""
    raw = image[:, :, 1].copy()
    raw[0::2, 0::2] = image[0::2, 0::2, 2]
    raw[1::2, 1::2] = image[1::2, 1::2, 0]
    return raw


def from_quadrants(quadrants: Image) -> Image:
    """Raw Bayer pixels (H, W) of four colour planes side by side: red, green above blue, green."""
    height, width = quadrants.shape
    if height % 2 or width % 2:
        raise LogError(f"found {width}×{height} px in four quadrants, expected even numbers")
    rows, columns = height // 2, width // 2
    raw = np.empty_like(quadrants)
    raw[0::2, 0::2] = quadrants[:rows, :columns]
    raw[0::2, 1::2] = quadrants[:rows, columns:]
    raw[1::2, 0::2] = quadrants[rows:, columns:]
    raw[1::2, 1::2] = quadrants[rows:, :columns]
    return raw


def encoded_size(data: bytes) -> tuple[int, int]:
    """(width, height) [px] that a PNG or JPEG states; LogError if it is none or states an absurd size."""
    try:
        width, height = stated_size(data)
    except ValueError as error:
        raise LogError(str(error)) from error
    if not (MIN_SIDE <= width <= MAX_SIDE and MIN_SIDE <= height <= MAX_SIDE):
        raise LogError(f"found {width}×{height} px, expected {MIN_SIDE} to {MAX_SIDE}")
    return width, height


def decode(data: bytes, *, color: bool = True) -> Image:
    """Pixels of a PNG or JPEG: (H, W, 3) BGR, or as they are stored; LogError if it is damaged."""
    encoded_size(data)
    try:
        check(data)
    except ValueError as error:
        raise LogError(str(error)) from error
    # Cameras do not turn; the marks of a photo's orientation are not for these pictures.
    how = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION if color else cv2.IMREAD_UNCHANGED
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), how)
    except cv2.error:
        image = None
    if image is None or image.dtype != np.uint8:
        raise LogError("found a picture that cannot be decoded to 8 bits")
    return np.asarray(image, dtype=np.uint8)
