"""Pictures from recordings and from users: raw Bayer pixels and encoded files.

The stated size is checked before memory is allocated for the pixels. Pillow reads the headers. Its `verify`
finds all damage to a PNG, but only 7 of 150 truncated JPEGs: these are checked for their end marker. OpenCV
fills missing parts of a damaged picture with grey, and reports that on stderr only.
"""

from __future__ import annotations

from importlib import import_module
from io import BytesIO
from typing import TYPE_CHECKING

import cv2
import numpy as np

from tracker.checks import naming
from tracker.conventions import Image
from tracker.errors import LogError
from tracker.logs.log import check_sides

if TYPE_CHECKING:
    from PIL.ImageFile import ImageFile

RECORDED = ("PNG", "JPEG")
READ = (*RECORDED, "BMP", "TIFF", "WebP")
"""Picture formats in recordings, and those accepted from users."""

_READERS = {
    b"\x89PNG\r\n\x1a\n": ("PNG", "Png"),
    b"\xff\xd8": ("JPEG", "Jpeg"),
    b"BM": ("BMP", "Bmp"),
    b"II*\0": ("TIFF", "Tiff"),
    b"MM\0*": ("TIFF", "Tiff"),
    b"RIFF": ("WebP", "WebP"),
}
"""Magic bytes, format and Pillow's name of the format."""


def from_bayer(raw: Image) -> Image:
    """Return the BGR image (H, W, 3) of raw pixels (H, W), red at even rows and columns."""
    # OpenCV names Bayer patterns after the second and third pixel of the second row.
    return np.asarray(cv2.cvtColor(raw, cv2.COLOR_BAYER_BG2BGR), dtype=np.uint8)


def to_bayer(image: Image) -> Image:
    """Return raw pixels (H, W) of a BGR image (H, W, 3), as a sensor with this mosaic measures them."""
    raw = image[:, :, 1].copy()
    raw[0::2, 0::2] = image[0::2, 0::2, 2]
    raw[1::2, 1::2] = image[1::2, 1::2, 0]
    return raw


def from_quadrants(quadrants: Image) -> Image:
    """Return raw Bayer pixels (H, W) of four colour planes: red and green above, blue and green below."""
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


def head_of(data: bytes, formats: tuple[str, ...] = RECORDED) -> ImageFile:
    """Read a picture's header; LogError if it is damaged, or of another format."""
    # `Image.open` would also warn about sizes that are rejected later anyway.
    for start, (name, reader) in _READERS.items():
        if name in formats and data.startswith(start):
            module = import_module(f"PIL.{reader}ImagePlugin")
            # Pillow may raise any error.
            with naming(f"found a {name} whose head cannot be read", LogError, Exception):
                picture: ImageFile = getattr(module, f"{reader}ImageFile")(BytesIO(data))
            return picture
    expected = f"{', '.join(formats[:-1])} or {formats[-1]}"
    raise LogError(f"found {len(data)} bytes that start with {data[:4]!r}, expected {expected}")


def check_whole(picture: ImageFile, data: bytes, *, appended: bool = False) -> None:
    """Check a picture's integrity as far as its format allows.

    A JPEG that may have data `appended` after its end, as photos of phones do, is decoded to check it.
    LogError: a part of a PNG does not match its checksum, or the end of a PNG or JPEG is missing.
    """
    endless = picture.format == "JPEG" and b"\xff\xd9" not in data[-64:]  # some writers pad
    if endless and not appended:
        raise LogError("found a JPEG without an end, it is truncated")
    with naming(f"found a damaged or truncated {picture.format}", LogError, Exception):
        if endless:
            picture.load()
        if picture.format == "PNG":
            picture.verify()


def decode(data: bytes, *, color: bool = True) -> Image:
    """Decode a PNG or JPEG to (H, W, 3) BGR, or unchanged if not `color`; LogError if it is damaged."""
    picture = head_of(data)
    check_sides(*picture.size)
    check_whole(picture, data)
    # Ignore EXIF orientation tags: they do not apply to fixed cameras.
    how = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION if color else cv2.IMREAD_UNCHANGED
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), how)
    except cv2.error:
        image = None
    if image is None or image.dtype != np.uint8:
        raise LogError("found a picture that cannot be decoded to 8 bits")
    return np.asarray(image, dtype=np.uint8)
