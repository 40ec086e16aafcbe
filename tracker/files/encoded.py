"""What encoded pictures state of themselves, looked at before memory is taken for their pixels.

Pillow reads the heads. Its `verify` finds all damage to a PNG, but only 7 of 150 JPEGs that were cut short:
of these the end is looked for.
"""

from __future__ import annotations

from importlib import import_module
from io import BytesIO
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from PIL.ImageFile import ImageFile

RECORDED = ("PNG", "JPEG")
READ = (*RECORDED, "BMP", "TIFF", "WebP")
"""Formats of recordings, and of pictures that a user hands over."""

_READERS = {
    b"\x89PNG\r\n\x1a\n": ("PNG", "Png"),
    b"\xff\xd8": ("JPEG", "Jpeg"),
    b"BM": ("BMP", "Bmp"),
    b"II*\0": ("TIFF", "Tiff"),
    b"MM\0*": ("TIFF", "Tiff"),
    b"RIFF": ("WebP", "WebP"),
}
"""First bytes, format and Pillow's name of it."""


def stated_size(data: bytes, formats: tuple[str, ...] = RECORDED) -> tuple[int, int]:
    """(width, height) [px] that a picture states, of any size; ValueError says what was found instead."""
    return _opened(data, formats)[1].size


def check(data: bytes, formats: tuple[str, ...] = RECORDED, *, appended: bool = False) -> None:
    """Look at a picture's integrity, as far as its format has means for it.

    A JPEG with something `appended` behind its end, as photos of telephones have, is decoded.

    Raises:
        ValueError: a part of a PNG does not agree with its checksum, or the end of a PNG or JPEG is missing.
    """
    name, picture = _opened(data, formats)
    endless = name == "JPEG" and b"\xff\xd9" not in data[-64:]  # some writers pad
    if endless and not appended:
        raise ValueError("found a JPEG without an end, it is truncated")
    try:
        if endless:
            picture.load()
        if name == "PNG":
            picture.verify()
    except Exception as error:  # whatever Pillow stumbles over
        raise ValueError(f"found a damaged or truncated {name}: {error}") from error


def _opened(data: bytes, formats: tuple[str, ...]) -> tuple[str, ImageFile]:
    """The format, and the picture with its head read; `Image.open` would warn of sizes that are refused."""
    for start, (name, reader) in _READERS.items():
        if name in formats and data.startswith(start):
            module = import_module(f"PIL.{reader}ImagePlugin")
            try:
                return name, getattr(module, f"{reader}ImageFile")(BytesIO(data))
            except Exception as error:  # whatever Pillow stumbles over
                raise ValueError(f"found a {name} whose head cannot be read: {error}") from error
    expected = f"{', '.join(formats[:-1])} or {formats[-1]}"
    raise ValueError(f"found {len(data)} bytes that start with {data[:4]!r}, expected {expected}")
