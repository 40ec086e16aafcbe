"""The options that say which cameras took the images."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

import click

if TYPE_CHECKING:
    from tracker.calibration.rig import CameraRig

_Command = TypeVar("_Command", bound=Callable[..., Any])

_CALIBRATION_HELP = (
    "Folder of calibration files; or a file, once for each camera, in the order of the images."
)

_MANY: dict[str, Any] = {"multiple": True, "metavar": "PATH"}

_OPTIONS = (
    click.option(
        "--pattern", metavar="GLOB", help="Which files of the folder to take, e.g. '*_cropped.yml'."
    ),
    click.option(
        "--correct-halved-principal-point",
        is_flag=True,
        help="The calibration was halved without the quarter pixel, as the platform's downsampled files are.",
    ),
)


def calibration_options(command: _Command) -> _Command:
    """Add the options to a command; their values are what `load_rig` takes."""
    return _add(command, click.option("--calibration", required=True, **_MANY, help=_CALIBRATION_HELP))


def optional_calibration_options(command: _Command) -> _Command:
    """The same for a command that can do without `--calibration`, which is empty then."""
    text = f"{_CALIBRATION_HELP}  [default: that of the recording]"
    return _add(command, click.option("--calibration", **_MANY, help=text))


def _add(command: _Command, calibration: Callable[[_Command], _Command]) -> _Command:
    for option in reversed((calibration, *_OPTIONS)):
        command = option(command)
    return command


def load_rig(
    calibration: Sequence[str], pattern: str | None, correct_halved_principal_point: bool
) -> CameraRig:
    """The rig that the options name.

    Raises:
        CalibrationError: see `CameraRig.load`.
    """
    from tracker.calibration.rig import CameraRig

    return CameraRig.load(
        calibration[0] if len(calibration) == 1 else calibration,
        pattern=pattern,
        correct_halved_principal_point=correct_halved_principal_point,
    )
