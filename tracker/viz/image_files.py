"""Image files."""

from __future__ import annotations

import os
from pathlib import Path

import cv2

from tracker.conventions import Array
from tracker.errors import ImageError
from tracker.files import told_as, write_whole

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg")
"""Formats of `write_image`."""


def write_image(path: str | os.PathLike[str], image: Array) -> None:
    """Write a PNG or JPEG file, whole or not at all.

    Raises:
        ImageError: the suffix is not one of IMAGE_SUFFIXES, or the file cannot be written.
    """
    target = Path(path)
    suffix = target.suffix.lower()
    if suffix not in IMAGE_SUFFIXES:
        found = f"suffix {target.suffix!r}" if target.suffix else "no suffix"
        raise ImageError(f"image {target}: found {found}, expected one of {', '.join(IMAGE_SUFFIXES)}")
    options = [cv2.IMWRITE_PNG_COMPRESSION, 5] if suffix == ".png" else [cv2.IMWRITE_JPEG_QUALITY, 95]
    content = cv2.imencode(suffix, image, options)[1].tobytes()
    with told_as(ImageError, f"image {target}"):
        write_whole(target, content)
