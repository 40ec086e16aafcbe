"""One set of pictures for a command: a file of each camera, or a frame of a recording or a folder."""

from __future__ import annotations

import contextlib
import dataclasses
import os
import re
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

import tracker
from tracker.cli import options
from tracker.errors import ImageError, LogError

if TYPE_CHECKING:
    from tracker.conventions import Image

NO_IMAGE = "none"  # stands for a missing image

PICTURES = {".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp"}

frame_option = options.whole("--frame", "Which frame of a recording or folder.  [default: 0]", least=0)


def one_set(
    images: Sequence[str], cameras: options.Cameras, frame: int | None
) -> tuple[tracker.CameraRig, list[Image | None]]:
    """The cameras, and a picture of each in their order; None where it gave none.

    A single path that is no picture is a recording, or a folder of pictures, with a calibration of its own
    unless one is given. Which of several files is whose: see `of_cameras`.
    """
    if len(images) == 1 and images[0] != NO_IMAGE and Path(images[0]).suffix.lower() not in PICTURES:
        path, number = Path(images[0]), frame or 0
        with tracker.open_log(path) as log:
            rig = cameras.rig_of(path, log)
            if number >= len(log):
                raise LogError(f"{path}: found no frame {number}, expected one from 0 to {len(log) - 1}")
            return rig, list(log[number].images)
    if frame is not None:
        raise click.UsageError("--frame is for recordings and folders; found image files")
    if not cameras.calibration:
        raise click.UsageError(
            "Missing option '--calibration': the folder with a file per camera, such as camera60.yml"
        )
    return read_images(images, cameras.load(), resize=cameras.resize_calibration)


def of_cameras(paths: Sequence[str], names: Sequence[str]) -> list[str]:
    """One set of files in the order of the cameras; NO_IMAGE stands for that of a camera that gave none.

    Files that are named after the cameras, or lie in folders that are, go to these. If none is, they come
    in the cameras' order. ImageError where there are too few or too many, or names contradict the cameras.
    """
    each = f"one for each of {', '.join(names)} ('{NO_IMAGE}' where a camera gave none)"
    if len(paths) != len(names):
        raise ImageError(f"images: found {len(paths)}, expected {len(names)}, {each}")
    given = [Path(path) for path in paths if path != NO_IMAGE]
    if not given:
        raise ImageError(f"images: found only '{NO_IMAGE}', expected at least one file")
    shared = len(given) > 1 and len({path.parent for path in given}) == 1  # the folder of all names none
    called = [
        camera_in(path.stem, names) or (None if shared else camera_in(path.parent.name, names))
        for path in given
    ]
    if not any(called):
        return list(paths)
    found: dict[str, Path] = {}
    for path, camera in zip(given, called, strict=True):
        if camera is None or camera not in names:
            whose = f"named after {camera}" if camera else "named after no camera, where others are"
            raise ImageError(f"{path}: {whose}; expected {each}")
        if camera in found:
            raise ImageError(f"{path}: named after {camera}, as {found[camera]} is; expected {each}")
        found[camera] = path
    return [str(found.get(name, NO_IMAGE)) for name in names]


def camera_in(text: str, names: Sequence[str]) -> str | None:
    """The camera whose name is in a file's or folder's name, not as part of a longer word or number.

    That may be none of `names`: another number after the word of one of them is another camera, and so are
    two of them.
    """
    words = {name.rstrip("0123456789") for name in names if name[-1].isdigit()} - {""}
    patterns = [*map(re.escape, names), *(rf"{re.escape(word)}\d+" for word in words)]
    found = set()
    for pattern in patterns:
        for match in re.finditer(rf"(?<![0-9A-Za-z])(?:{pattern})", text):
            after = text[match.end() :][:1]
            if not (after.isdigit() if match[0][-1].isdigit() else after.isalpha()):
                found.add(match[0])
    whole = sorted(one for one in found if not any(one in other for other in found - {one}))
    return " and ".join(whole) or None


def read_images(
    paths: Sequence[str], rig: tracker.CameraRig, *, resize: bool = False
) -> tuple[tracker.CameraRig, list[Image | None]]:
    """The rig of the images' sizes, and the images in its order, None where a camera gave none."""
    from tracker.color_learning.labelled import read_image
    from tracker.logs.opening import sized_for

    images: list[Image | None] = []
    cameras = []
    for path, camera in zip(of_cameras(paths, rig.names), rig, strict=True):
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
    """Drop what compiled libraries write to stderr, e.g. libpng's remarks on a broken file."""
    if sys.stderr is None:  # it was closed by the parent process
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
