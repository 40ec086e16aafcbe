"""One set of pictures for a command: a file of each camera, or a frame of a recording or a folder."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from tracker.cli.calibration import Cameras, load_rig, rig_of
from tracker.cli.read_images import NO_IMAGE, read_images

if TYPE_CHECKING:
    from tracker.calibration.rig import CameraRig
    from tracker.conventions import Image

_Command = TypeVar("_Command", bound=Callable[..., Any])

PICTURES = {".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp"}

frame_option = click.option(
    "--frame",
    type=click.IntRange(min=0),
    metavar="N",
    help="Which frame of a recording or folder.  [default: 0]",
)


def one_set(
    images: Sequence[str], cameras: Cameras, frame: int | None
) -> tuple[CameraRig, list[Image | None]]:
    """The cameras, and a picture of each in their order; None where it gave none.

    A single path that is no picture is a recording, or a folder of pictures, with a calibration of its own
    unless one is given. Files that are named after all cameras go to those; others come in their order.

    Raises:
        TrackerError: pictures, calibration or recording cannot be read, or do not belong together.
    """
    if len(images) == 1 and images[0] != NO_IMAGE and Path(images[0]).suffix.lower() not in PICTURES:
        return _frame_of(Path(images[0]), cameras, frame or 0)
    if frame is not None:
        raise click.UsageError("--frame is one of a recording's or a folder's; found picture files")
    cameras.refuse_pattern_alone()
    if not cameras.calibration:
        raise click.UsageError(
            "Missing option '--calibration': the folder with a file of each camera, like camera60.yml"
        )
    rig = load_rig(cameras)
    return read_images(_in_order(images, rig.names), rig, resize=cameras.resize_calibration)


def _frame_of(path: Path, cameras: Cameras, number: int) -> tuple[CameraRig, list[Image | None]]:
    from tracker.errors import LogError
    from tracker.logs import open_log

    with open_log(path) as log:
        rig = rig_of(path, log, cameras)
        if number >= len(log):
            raise LogError(f"{path}: found no frame {number}, expected one from 0 to {len(log) - 1}")
        return rig, list(log[number].images)


def _in_order(paths: Sequence[str], names: Sequence[str]) -> list[str]:
    """Files in the cameras' order, where their names say it; else as they are, with a word of warning."""
    told = [_named(path, names) for path in paths]
    if sorted(filter(None, told)) == sorted(names):
        return [paths[told.index(name)] for name in names]
    for path, name, camera in zip(paths, told, names, strict=False):
        if name not in (None, camera):
            click.echo(f"tracker: {path}: taken for the picture of {camera}, not of {name}", err=True)
    return list(paths)


def _named(path: str, names: Sequence[str]) -> str | None:
    """The one camera that a file or its folder is named after, if there is one."""
    text = "/".join(Path(path).parts[-2:])
    found = [name for name in names if re.search(rf"(?<![0-9A-Za-z]){re.escape(name)}(?![0-9A-Za-z])", text)]
    return found[0] if len(found) == 1 else None
