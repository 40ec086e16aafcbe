"""The options that say which cameras took the images."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

if TYPE_CHECKING:
    from tracker.calibration.rig import CameraRig
    from tracker.logs import Log

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


def refuse_pattern_alone(calibration: Sequence[str], pattern: str | None) -> None:
    """Refuse `--pattern` without `--calibration`."""
    if pattern is not None and not calibration:
        raise click.UsageError("--pattern says which files of --calibration to take, and that is missing")


def rig_of(path: Path, log: Log, calibration: Sequence[str], pattern: str | None, correct: bool) -> CameraRig:
    """The rig that the options name, without `--calibration` the recording's own, in the order of its images.

    Raises:
        CalibrationError: there is none, or it does not fit the recording.
    """
    from tracker.logs.cameras import fitted_to, own_rig

    refuse_pattern_alone(calibration, pattern)
    if calibration:
        return fitted_to(path, log, load_rig(calibration, pattern, correct))
    return own_rig(path, log, correct_halved_principal_point=correct)
