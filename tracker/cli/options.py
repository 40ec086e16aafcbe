"""Options shared by several commands: the object, its colours, the cameras, part of a recording."""

import functools
import inspect
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
from click.shell_completion import CompletionItem

import tracker
from tracker.cli.outputs import Command, InFile, OutFile
from tracker.logs.opening import fitted_to
from tracker.objects.model import object_names
from tracker.recordings.track import chosen
from tracker.segmentation.color_model import color_model_names

_SHORT = {"output": ["-o"], "quiet": ["-q"]}


def option(metavar: str | None, help: str, kind: Any = None, *, name: str = "", **how: Any) -> Any:
    """Make an option for the argument that has it as its default; its name is the argument's, or `name`."""

    def of(to: str) -> click.Option:
        names = [name] if name else [*_SHORT.get(to, ()), f"--{to.replace('_', '-')}"]
        return click.Option([*names, to], metavar=metavar, help=help, type=kind, **how)

    return of


def argument(metavar: str, kind: Any, **how: Any) -> Any:
    """Make a positional argument, given exactly once."""
    return lambda to: click.Argument([to], metavar=metavar, type=kind, **how)


def several(metavar: str, kind: Any) -> Any:
    """Make a positional argument that is given once or more."""
    return argument(f"{metavar}...", kind, nargs=-1, required=True)


def whole(
    help: str, *, default: int | None = None, least: int = 1, most: int | None = None, name: str = ""
) -> Any:
    """Make an option for an integer whose help shows its default."""
    kind = click.IntRange(least, most)
    return option("N", help, kind, name=name, default=default, show_default=default is not None)


class Range(click.FloatRange):
    """A range that excludes NaN, which click's own accepts."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """See click."""
        number = super().convert(value, param, ctx)
        if math.isnan(number):
            self.fail(f"found {value}, expected a number", param, ctx)
        return number


def flag(help: str, *, name: str = "") -> Any:
    """Make an option without a value."""
    return option(None, help, name=name, is_flag=True)


def file_option(help: str, *suffixes: str, required: bool = False, **kind: Any) -> Any:
    """Make an option for a file to write, see OutFile."""
    return option("FILE", help, OutFile(*suffixes, **kind), required=required)


def command(group: Any = click, **how: Any) -> Any:
    """Make a command of a function whose arguments have options as their defaults.

    An argument without a default is a dataclass of such fields, as its annotation says.
    """

    def make(function: Callable[..., Any]) -> Any:
        called = functools.wraps(function)(lambda **values: _call(function, values))
        return group.command(cls=Command, params=_parameters(function), **how)(called)

    return make


def _parameters(function: Callable[..., Any]) -> list[click.Parameter]:
    found: list[click.Parameter] = []
    for name, its in inspect.signature(function, eval_str=True).parameters.items():
        found += _parameters(its.annotation) if its.default is its.empty else [its.default(name)]
    return found


def _call(function: Callable[..., Any], values: dict[str, Any]) -> Any:
    """Call a function or dataclass with its own among the values of all parameters."""
    own = {}
    for name, its in inspect.signature(function, eval_str=True).parameters.items():
        own[name] = _call(its.annotation, values) if its.default is its.empty else values[name]
    return function(**own)


recover = flag("Leave out damaged parts of a recording.")
seed = whole("Seed of random choices.", least=0, default=0)
as_json = flag("Print one JSON object.", name="--json")


def _name_or_file(name: str, known: Sequence[str], text: str, default: str) -> Any:
    """Make an option for a known name or a file; shells complete both.

    `text` is the help, with `{}` for the names. The option is required unless `default` says what is used
    without it.
    """

    def complete(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
        found = [CompletionItem(one) for one in known if one.startswith(incomplete)]
        return found or [CompletionItem(incomplete, type="file")]

    text = text.format(", ".join(known)) + (default and f"  [default: {default}]")
    return option("NAME", text, InFile(str), name=name, required=not default, shell_complete=complete)


def numbers(count: int) -> Callable[[str], tuple[float, ...]]:
    """Return a function that parses `count` comma-separated numbers, such as X,Y,Z: the type of an option."""

    def read(value: str) -> tuple[float, ...]:
        try:
            found = tuple(map(float, value.split(",")))
        except ValueError:
            found = ()
        if len(found) != count or not all(map(math.isfinite, found)):
            valid = ",".join("XYZ"[:count])
            raise click.BadParameter(f"found {value!r}, expected {count} numbers, {valid}")
        return found

    return read


def object_name(default: str = "") -> Any:
    """Make `--object`; it is required unless `default` says what is used without it."""
    return _name_or_file("--object", object_names(), "{}, or a TOML file.", default)


def colors(default: str = "the object's") -> Any:
    """Make `--colors`; `default` says what is used without it."""
    text = "Colour model: {}, or a file (.npz)."
    return _name_or_file("--colors", color_model_names(), text, default)


@dataclass(frozen=True)
class Subject:
    """The object to find, and its colours."""

    object: str = object_name()
    colors: str | None = colors()

    def load(self) -> tuple[tracker.CuboidModel, tracker.ColorModel]:
        """Load the object and its colours; TrackerError if one is unknown or malformed."""
        model = tracker.load_object(self.object)
        return model, tracker.load_colors(self.colors or model.colors)


@dataclass(frozen=True)
class Cameras:
    """The calibration, and how to change it; UsageError if options contradict each other."""

    calibration: tuple[str, ...] = option(
        "PATH",
        "Folder of calibration files; or a file, repeated for each camera in the order of the images.  "
        "[default: that of the recording]",
        InFile(str),
        multiple=True,
    )
    pattern: str | None = option(
        "GLOB", "Files of the folder, e.g. '*_cropped.yml'.  [default: '*camera*.yml' or .yaml, else all]"
    )
    correct_halved_principal_point: bool = flag(
        "The calibration was halved without the quarter pixel, as in the platform's downsampled files."
    )
    resize_calibration: bool = flag("The images were scaled after the calibration.")

    def __post_init__(self) -> None:
        if self.pattern is not None and not self.calibration:
            raise click.UsageError("--pattern selects files of --calibration, which is missing")

    def load(self) -> tracker.CameraRig:
        """Load the rig given by the options, with its files' image sizes; errors as in `CameraRig.load`."""
        return tracker.CameraRig.load(
            self.calibration,
            pattern=self.pattern,
            correct_halved_principal_point=self.correct_halved_principal_point,
        )

    def rig_of(self, path: Path, log: tracker.Log) -> tracker.CameraRig:
        """Return the rig given by the options, or else the recording's own, see `fitted_to`."""
        correct, resize = self.correct_halved_principal_point, self.resize_calibration
        rig = self.load() if self.calibration else None
        return fitted_to(path, log, rig, correct_halved_principal_point=correct, resize=resize)


@dataclass(frozen=True)
class Part:
    """The part of a recording to read; UsageError if it is empty."""

    start: int = whole("First frame.", least=0, default=0, name="--from")
    stop: int | None = whole("End: the frame after the last.", name="--to")
    recover: bool = recover

    def __post_init__(self) -> None:
        if self.stop is not None and self.stop <= self.start:
            raise click.UsageError(f"--from {self.start} --to {self.stop}: expected --to beyond --from")

    def of(self, path: Path, count: int) -> range:
        """Return the part's frame numbers in a recording of `count` frames, see `chosen`."""
        return chosen(path, count, self.start, self.stop)


@dataclass(frozen=True)
class Asked:
    """Options for the object to find in recordings, and for reading them."""

    subject: Subject
    cameras: Cameras
    part: Part

    def options(self) -> tracker.recordings.Options:
        """Return the options as plain values that work in any process on any machine."""
        return tracker.recordings.Options(**vars(self.subject), **vars(self.cameras), **vars(self.part))
