"""The options that say which cameras took the images."""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar, cast

import click

if TYPE_CHECKING:
    from tracker.calibration.rig import CameraRig
    from tracker.logs import Log

_Command = TypeVar("_Command", bound=Callable[..., Any])


class Cameras(NamedTuple):
    """What the options say, in the order of `tracker.recordings.Options`."""

    calibration: tuple[str, ...]
    """A folder of calibration files, or a file for each camera; none: that of the recording."""
    pattern: str | None
    """Which files of the folder."""
    correct_halved_principal_point: bool
    """Whether the calibration was halved without the quarter pixel."""
    resize_calibration: bool
    """Whether a calibration of another size is scaled to the images'."""

    def refuse_pattern_alone(self) -> None:
        """Refuse `--pattern` without `--calibration`."""
        if self.pattern is not None and not self.calibration:
            raise click.UsageError("--pattern says which files of --calibration to take, and that is missing")


_OPTIONS = (
    click.option(
        "--calibration",
        multiple=True,
        metavar="PATH",
        help="Folder of calibration files; or a file, once for each camera, in the order of the images.  "
        "[default: that of the recording]",
    ),
    click.option(
        "--pattern", metavar="GLOB", help="Which files of the folder to take, e.g. '*_cropped.yml'."
    ),
    click.option(
        "--correct-halved-principal-point",
        is_flag=True,
        help="The calibration was halved without the quarter pixel, as the platform's downsampled files are.",
    ),
    click.option(
        "--resize-calibration",
        is_flag=True,
        help="The images are those that were calibrated, scaled to another size.",
    ),
)


def calibration_options(command: _Command) -> _Command:
    """Add the options to a command; it is called with their values as `cameras`, see Cameras."""

    @functools.wraps(command)
    def gathered(**values: Any) -> Any:
        cameras = Cameras(*(values.pop(name) for name in Cameras._fields))
        return command(cameras=cameras, **values)

    result = cast("_Command", gathered)
    for option in reversed(_OPTIONS):
        result = option(result)
    return result


def load_rig(cameras: Cameras) -> CameraRig:
    """The rig that the options name, of the size that its files say.

    Raises:
        CalibrationError: see `CameraRig.load`.
    """
    from tracker.calibration.rig import CameraRig

    calibration = cameras.calibration
    return CameraRig.load(
        calibration[0] if len(calibration) == 1 else calibration,
        pattern=cameras.pattern,
        correct_halved_principal_point=cameras.correct_halved_principal_point,
    )


def rig_of(path: Path, log: Log, cameras: Cameras) -> CameraRig:
    """The rig that the options name, without `--calibration` the recording's own, in the order of its images.

    Raises:
        CalibrationError: there is none, or it does not fit the recording.
    """
    from tracker.logs.cameras import fitted_to, own_rig

    cameras.refuse_pattern_alone()
    resize = cameras.resize_calibration
    if cameras.calibration:
        return fitted_to(path, log, load_rig(cameras), resize=resize)
    correct = cameras.correct_halved_principal_point
    return own_rig(path, log, correct_halved_principal_point=correct, resize=resize)
