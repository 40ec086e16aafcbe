"""What the commands that mend a calibration are given: recordings, pictures, and their cameras."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from tracker.cli.calibration import Cameras, calibration_options, load_rig, rig_of
from tracker.cli.names import colors_option, object_option
from tracker.cli.read_images import NO_IMAGE, read_images
from tracker.errors import CalibrationError, ImageError

if TYPE_CHECKING:
    from tracker.calibration.rig import CameraRig
    from tracker.upkeep.footage import Footage

_PICTURES = (".png", ".jpg", ".jpeg")
_Command = TypeVar("_Command", bound=Callable[..., Any])

_INPUTS = (
    click.argument("inputs", nargs=-1, required=True, metavar="RECORDING|IMAGE..."),
    object_option(),
)

_OUTPUT = click.option(
    "-o",
    "--output",
    required=True,
    metavar="DIR",
    type=click.Path(path_type=Path),
    help="Folder of the calibration that is found, a new or an empty one.",
)

_READING = (
    calibration_options,
    colors_option(),
    click.option(
        "--stills",
        is_flag=True,
        help="Frames of folders are no films: each was taken by itself, at any moment.",
    ),
    click.option("--recover", is_flag=True, help="Leave out what is damaged of a recording."),
    click.option("-q", "--quiet", is_flag=True, help="Say nothing but errors."),
)


def mending_options(command: _Command) -> _Command:
    """Add to a command the options that all have which mend a calibration."""
    return _add(command, (*_INPUTS, _OUTPUT, *_READING))


def looking_options(command: _Command) -> _Command:
    """The same without the folder for what is found."""
    return _add(command, (*_INPUTS, *_READING))


def _add(command: _Command, options: Sequence[Callable[[_Command], _Command]]) -> _Command:
    for option in reversed(options):
        command = option(command)
    return command


def check_output(output: Path) -> None:
    """Refuse a folder that holds something: it might be the calibration that is to be mended."""
    if output.exists() and not (output.is_dir() and not any(output.iterdir())):
        raise click.UsageError(f"-o {output}: found it in use, expected a new or an empty folder")


@contextmanager
def opened(
    inputs: Sequence[str],
    cameras: Cameras,
    stills: bool,
    recover: bool,
) -> Iterator[tuple[CameraRig, list[Footage], int]]:
    """The rig, what it filmed, and how many frames that is; recordings are open within the `with` block.

    Args:
        inputs: recordings, and pictures, those of one moment one after the other.
        cameras: as for `load_rig`; without a calibration the first recording's own is taken.
        stills: frames of recordings are no films.
        recover: damaged frames are left out.

    Raises:
        TrackerError: something cannot be read, or the cameras are not the same all over.
    """
    from tracker.logs import open_log
    from tracker.upkeep.footage import Film, Stills

    pictures = [path for path in inputs if path == NO_IMAGE or Path(path).suffix.lower() in _PICTURES]
    rig = load_rig(cameras) if cameras.calibration else None
    footage: list[Footage] = []
    frames = 0
    with ExitStack() as stack:
        for path in inputs:
            if path in pictures:
                continue
            log = stack.enter_context(open_log(path, recover=recover))
            its = rig_of(Path(path), log, cameras)
            _refuse_other(path, its, rig if rig is not None and footage else its)
            rig = its
            footage.append(Film(log, stills=stills))
            frames += len(log)
        if rig is None:
            raise CalibrationError("images: found no calibration, expected --calibration")
        if pictures:
            rig, sets = _sets(pictures, rig, resize=cameras.resize_calibration and not footage)
            footage.append(Stills(sets))
            frames += len(sets)
        yield rig, footage, frames


def _sets(pictures: Sequence[str], rig: CameraRig, *, resize: bool) -> tuple[CameraRig, list[Any]]:
    """The rig of the pictures' size, and pictures of one moment each."""
    count = len(rig)
    if len(pictures) % count:
        raise ImageError(
            f"images: found {len(pictures)}, expected a multiple of {count}: one for each of "
            f"{', '.join(rig.names)} ('{NO_IMAGE}' where a camera gave none), moment by moment"
        )
    sets = []
    for first in range(0, len(pictures), count):
        rig, images = read_images(pictures[first : first + count], rig, resize=resize and not first)
        sets.append(images)
    return rig, sets


def _refuse_other(path: str, its: CameraRig, rig: CameraRig) -> None:
    """Raise where a recording's cameras are not those of the recordings before it."""
    import numpy as np

    for one, other in zip(its, rig, strict=False):
        same = one.name == other.name and all(
            np.array_equal(getattr(one, key), getattr(other, key))
            for key in ("matrix", "distortion", "camera_from_world")
        )
        if not same:
            raise CalibrationError(
                f"{path}: found another calibration of {one.name} than that of the recordings before it, "
                "expected the same, or --calibration"
            )
