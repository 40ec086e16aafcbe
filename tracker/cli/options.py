"""Options that several commands have: the object, its colours, the cameras, a part of a recording."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar, cast

import click
from click.shell_completion import CompletionItem

from tracker.cli.outputs import InFile, Input

if TYPE_CHECKING:
    from tracker.calibration.rig import CameraRig
    from tracker.logs import Log

_Command = TypeVar("_Command", bound=Callable[..., Any])
_ROOMS = Path(__file__).parents[1]
OBJECTS = tuple(sorted(path.stem for path in (_ROOMS / "objects" / "data").glob("*.toml")))
"""The objects that come with the package."""

COLORS = tuple(sorted(path.stem for path in (_ROOMS / "segmentation" / "data").glob("*.npz")))
"""The colour models that come with it."""


def together(*options: Callable[[_Command], _Command]) -> Callable[[_Command], _Command]:
    """Several options, in this order, as one decorator."""

    def add(command: _Command) -> _Command:
        for option in reversed(options):
            command = option(command)
        return command

    return add


def gathered(
    name: str, kind: type, *options: Callable[[_Command], _Command]
) -> Callable[[_Command], _Command]:
    """Options that a command gets as one argument, `name`: a `kind` of their values, by its fields."""

    def add(command: _Command) -> _Command:
        @functools.wraps(command)
        def with_one(**values: Any) -> Any:
            return command(**{name: kind(**{key: values.pop(key) for key in kind.__annotations__})}, **values)

        return together(*options)(cast("_Command", with_one))

    return add


recover_option = click.option("--recover", is_flag=True, help="Leave out what is damaged of a recording.")
json_option = click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")


def quiet_option(said: str = "Say nothing but errors.") -> Callable[[_Command], _Command]:
    """`--quiet`, which keeps a command from saying what `said` says."""
    return click.option("-q", "--quiet", is_flag=True, help=said)


class _NameOrFile(Input, click.ParamType):  # type: ignore[type-arg]  # which older ones do not take
    """One of some names, or a file."""

    name = "name"

    def __init__(self, names: tuple[str, ...]) -> None:
        self.names = names

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        """The names that begin so, else files."""
        found = [CompletionItem(name) for name in self.names if name.startswith(incomplete)]
        return found or [CompletionItem(incomplete, type="file")]


class Vector(click.ParamType):  # type: ignore[type-arg]
    """Numbers with commas between them, as X,Y,Z."""

    name = "vector"

    def __init__(self, count: int) -> None:
        self.count = count

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[float, ...]:
        """See click.ParamType."""
        if isinstance(value, tuple):
            return value
        try:
            found = tuple(float(part) for part in str(value).split(","))
        except ValueError:
            found = ()
        if len(found) != self.count or not all(map(math.isfinite, found)):
            valid = ",".join("XYZ"[: self.count])
            self.fail(f"found {value!r}, expected {self.count} numbers, {valid}", param, ctx)
        return found


def object_option(default: str = "") -> Callable[[_Command], _Command]:
    """`--object`, required unless `default` says which is taken without it."""
    said = f"{', '.join(OBJECTS)}, or a TOML file.{default and f'  [default: {default}]'}"
    return click.option(
        "--object", "object_name", required=not default, metavar="NAME", type=_NameOrFile(OBJECTS), help=said
    )


def colors_option(default: str = "the object's") -> Callable[[_Command], _Command]:
    """`--colors`; `default` says which are taken without it."""
    said = f"Colour model: {', '.join(COLORS)}, or a file (.npz).  [default: {default}]"
    return click.option("--colors", "colors_name", metavar="NAME", type=_NameOrFile(COLORS), help=said)


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


_cameras = gathered(
    "cameras",
    Cameras,
    click.option(
        "--calibration",
        multiple=True,
        metavar="PATH",
        type=InFile(str),
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
    def checked(*, cameras: Cameras, **values: Any) -> Any:
        if cameras.pattern is not None and not cameras.calibration:
            raise click.UsageError("--pattern says which files of --calibration to take, and that is missing")
        return command(cameras=cameras, **values)

    return _cameras(cast("_Command", checked))


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

    resize = cameras.resize_calibration
    if cameras.calibration:
        return fitted_to(path, log, load_rig(cameras), resize=resize)
    correct = cameras.correct_halved_principal_point
    return own_rig(path, log, correct_halved_principal_point=correct, resize=resize)


_part = together(
    click.option(
        "--from", "first", metavar="N", type=click.IntRange(0), default=0, help="First frame wanted."
    ),
    click.option(
        "--to", "last", metavar="N", type=click.IntRange(1), help="First frame not wanted any more."
    ),
)


def part_options(command: _Command) -> _Command:
    """`--from` and `--to`; the command gets the numbers `first`, and `last` or None, which is beyond."""

    @functools.wraps(command)
    def checked(*, first: int, last: int | None, **values: Any) -> Any:
        if last is not None and last <= first:
            raise click.UsageError(f"--from {first} --to {last}: expected --to beyond --from")
        return command(first=first, last=last, **values)

    return _part(cast("_Command", checked))
