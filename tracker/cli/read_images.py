"""Images from files, without what OpenCV says of them on the way."""

from __future__ import annotations

import contextlib
import dataclasses
import os
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from tracker.errors import ImageError

if TYPE_CHECKING:
    from tracker.calibration.rig import CameraRig
    from tracker.conventions import Image

NO_IMAGE = "none"
"""Given in place of an image: its camera gave none."""


def read_images(
    paths: Sequence[str], rig: CameraRig, *, resize: bool = False
) -> tuple[CameraRig, list[Image | None]]:
    """The rig of the images' sizes, and the images in its order, None where the path is NO_IMAGE.

    Raises:
        ImageError: an image cannot be read, or their count is wrong.
        CalibrationError: an image is not of its camera's size; with `resize`: not of its shape.
    """
    from tracker.logs.cameras import sized_for
    from tracker.segmentation.labelled import read_image

    if len(paths) != len(rig):
        raise ImageError(
            f"images: found {len(paths)}, expected {len(rig)}, one for each of {', '.join(rig.names)} "
            f"('{NO_IMAGE}' where a camera gave none)"
        )
    if all(path == NO_IMAGE for path in paths):
        raise ImageError(f"images: found only '{NO_IMAGE}', expected at least one file")
    images: list[Image | None] = []
    cameras = []
    for path, camera in zip(paths, rig, strict=True):
        if path == NO_IMAGE:
            images.append(None)
            cameras.append(camera)
            continue
        with silent_libraries():
            image = read_image(Path(path))
        size = image.shape[1], image.shape[0]
        cameras.append(sized_for(size, camera, f"image {path}", resize=resize))
        images.append(image)
    return dataclasses.replace(rig, cameras=tuple(cameras)), images


@contextlib.contextmanager
def silent_libraries() -> Iterator[None]:
    """Drop what compiled libraries write to stderr, e.g. what libpng thinks of a broken file."""
    if sys.stderr is None:  # it was closed by whoever started us
        yield
        return
    sys.stderr.flush()
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    try:
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)
