"""Calibration files of photos as they are, and of the smaller images that a platform makes of them."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

if TYPE_CHECKING:
    from tracker.calibration.calibrated import Calibrated

_Command = TypeVar("_Command", bound=Callable[..., Any])

_OPTIONS = (
    click.option(
        "--crop",
        metavar="WxH+L+T",
        help="Write NAME_cropped.yml too, of the photos' part of W×H px that starts at (L, T): on the "
        "platform 540x540+88+0.",
    ),
    click.option(
        "--halve",
        is_flag=True,
        help="Write NAME_downsampled.yml too, with --crop NAME_cropped_and_downsampled.yml: of halved "
        "images, the quarter pixel right.",
    ),
)


def size_options(command: _Command) -> _Command:
    """Add the options to a command; their values are what `variants` takes."""
    for option in reversed(_OPTIONS):
        command = option(command)
    return command


def variants(calibrated: Calibrated, path: Path, crop: str | None, halve: bool) -> dict[Path, Calibrated]:
    """The files to write: `path` of the photos' size, and those of the options beside it.

    Raises:
        click.UsageError: --crop cannot be read.
        CalibrationError: the part is not inside of the photo.
    """
    files, last, suffix = {path: calibrated}, calibrated, ""
    if crop is not None:
        part = re.fullmatch(r"(\d{1,5})x(\d{1,5})\+(\d{1,5})\+(\d{1,5})", crop)
        if part is None:
            raise click.UsageError(f"--crop {crop!r}: expected WxH+L+T, e.g. 540x540+88+0")
        width, height, left, top = (int(number) for number in part.groups())
        last, suffix = calibrated.cropped(left, top, width, height), "_cropped"
        files[path.with_stem(path.stem + suffix)] = last
    if halve:
        suffix += "_and_downsampled" if suffix else "_downsampled"
        files[path.with_stem(path.stem + suffix)] = last.resized(
            last.camera.width // 2, last.camera.height // 2
        )
    return files
