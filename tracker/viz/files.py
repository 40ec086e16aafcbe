"""Image files."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import cv2

from tracker.conventions import Image
from tracker.errors import ImageError

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg")
"""Formats of `write_image`."""


def write_image(path: str | os.PathLike[str], image: Image) -> None:
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
    try:
        _replace(target, content)
    except (OSError, ValueError) as error:  # ValueError: a null byte in the path
        reason = error.strerror if isinstance(error, OSError) else error
        raise ImageError(f"image {target}: cannot be written: {reason}") from error


def _replace(target: Path, content: bytes) -> None:
    handle, temporary = tempfile.mkstemp(dir=target.parent, prefix=f".{target.name}.", suffix=".tmp")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
        # mkstemp makes a file that only its owner can read; give it the mode of any new file.
        umask = os.umask(0)
        os.umask(umask)
        os.chmod(temporary, 0o666 & ~umask)
        os.replace(temporary, target)
    except BaseException:
        os.unlink(temporary)
        raise
