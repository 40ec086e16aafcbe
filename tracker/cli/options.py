"""Options that several commands have: the object, its colours, the cameras, a part of a recording."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar, cast

import click
from click.shell_completion import CompletionItem

import tracker
from tracker.cli.outputs import InFile
from tracker.errors import LogError

_Command = TypeVar("_Command", bound=Callable[..., Any])
_ROOMS = Path(__file__).parents[1]
OBJECTS = tuple(sorted(path.stem for path in (_ROOMS / "objects" / "data").glob("*.toml")))
"""The objects that come with the package."""

COLORS = tuple(sorted(path.stem for path in (_ROOMS / "segmentation" / "data").glob("*.npz")))
"""The colour models that come with it."""


def gathered(
    name: str, kind: type, *options: Callable[[_Command], _Command]
) -> Callable[[_Command], _Command]:
    """Options that a command gets as one argument, `name`: a `kind` of their values, by its fields."""

    def add(command: _Command) -> _Command:
        @functools.wraps(command)
        def with_one(**values: Any) -> Any:
            return command(**{name: kind(**{key: values.pop(key) for key in kind.__annotations__})}, **values)

        gathering = cast("_Command", with_one)
        for option in reversed(options):
            gathering = option(gathering)
        return gathering

    return add


def whole(
    name: str, help: str, *, default: int | None = None, least: int = 1, most: int | None = None, to: str = ""
) -> Callable[[_Command], _Command]:
    """An option of a whole number, whose default is shown; `to`: the argument that it becomes."""
    kind, names = click.IntRange(least, most), (name, to) if to else (name,)
    return click.option(
        *names, metavar="N", type=kind, default=default, show_default=default is not None, help=help
    )


recover = click.option("--recover", is_flag=True, help="Leave out damaged parts of a recording.")
seed = whole("--seed", "Seed of random choices.", least=0, default=0)
as_json = click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")


def quiet(text: str = "Print errors only.") -> Callable[[_Command], _Command]:
    """`--quiet`, with `text` as its help."""
    return click.option("-q", "--quiet", is_flag=True, help=text)


class _NameOrFile(InFile):
    """One of some names, or a file."""

    def __init__(self, names: tuple[str, ...]) -> None:
        super().__init__(str)
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


def object_name(default: str = "") -> Callable[[_Command], _Command]:
    """`--object`, required unless `default` says which is taken without it."""
    text = f"{', '.join(OBJECTS)}, or a TOML file.{default and f'  [default: {default}]'}"
    return click.option(
        "--object", "object_name", required=not default, metavar="NAME", type=_NameOrFile(OBJECTS), help=text
    )


def colors(default: str = "the object's") -> Callable[[_Command], _Command]:
    """`--colors`; `default` says which are taken without it."""
    text = f"Colour model: {', '.join(COLORS)}, or a file (.npz).  [default: {default}]"
    return click.option("--colors", "colors_name", metavar="NAME", type=_NameOrFile(COLORS), help=text)


@dataclass(frozen=True)
class Subject:
    """The object to find."""

    object_name: str
    """The object, or its TOML file."""
    colors_name: str | None
    """The colour model, or its file; None: the object's."""

    def load(self) -> tuple[tracker.CuboidModel, tracker.ColorModel]:
        """The object and its colours; TrackerError where one is unknown or malformed."""
        model = tracker.load_object(self.object_name)
        return model, tracker.load_colors(self.colors_name or model.colors)


subject = gathered("subject", Subject, object_name(), colors())


@dataclass(frozen=True)
class Cameras:
    """The calibration, and how to change it; UsageError if options contradict each other."""

    calibration: tuple[str, ...]
    """A folder of calibration files, or a file for each camera; none: that of the recording."""
    pattern: str | None
    """Which files of the folder."""
    correct_halved_principal_point: bool
    """Whether the calibration was halved without the quarter pixel."""
    resize_calibration: bool
    """Whether a calibration of another size is scaled to the images'."""

    def __post_init__(self) -> None:
        if self.pattern is not None and not self.calibration:
            raise click.UsageError("--pattern selects files of --calibration, which is missing")

    def load(self) -> tracker.CameraRig:
        """The rig that the options name, of the size that its files say; CalibrationError as for `load`."""
        return tracker.CameraRig.load(
            self.calibration[0] if len(self.calibration) == 1 else self.calibration,
            pattern=self.pattern,
            correct_halved_principal_point=self.correct_halved_principal_point,
        )

    def rig_of(self, path: Path, log: tracker.Log) -> tracker.CameraRig:
        """The rig that the options name, else the recording's own, see `fitted_to`."""
        from tracker.logs.opening import fitted_to

        correct, resize = self.correct_halved_principal_point, self.resize_calibration
        rig = self.load() if self.calibration else None
        return fitted_to(path, log, rig, correct_halved_principal_point=correct, resize=resize)


cameras = gathered(
    "cameras",
    Cameras,
    click.option(
        "--calibration",
        multiple=True,
        metavar="PATH",
        type=InFile(str),
        help="Folder of calibration files; or a file, repeated for each camera in the order of the images.  "
        "[default: that of the recording]",
    ),
    click.option(
        "--pattern",
        metavar="GLOB",
        help="Files of the folder to use, e.g. '*_cropped.yml'.  [default: '*camera*.yml']",
    ),
    click.option(
        "--correct-halved-principal-point",
        is_flag=True,
        help="The calibration was halved without the quarter pixel, as in the platform's downsampled files.",
    ),
    click.option(
        "--resize-calibration",
        is_flag=True,
        help="The images were scaled after the calibration.",
    ),
)


@dataclass(frozen=True)
class Part:
    """The part of a recording to read; UsageError if it is empty."""

    first: int
    """Number of the first frame."""
    last: int | None
    """Number of the first frame after them; None: the recording's end."""
    recover: bool
    """Whether what is damaged is left out."""

    def __post_init__(self) -> None:
        if self.last is not None and self.last <= self.first:
            raise click.UsageError(f"--from {self.first} --to {self.last}: expected --to beyond --from")

    def of(self, path: Path, count: int) -> range:
        """Numbers of its frames, of so many; LogError where they end before it begins."""
        if self.first and self.first >= count:
            frames = f"frames 0 to {count - 1}" if count else "no frames"
            raise LogError(f"{path}: `--from {self.first}`: the recording has {frames}")
        return range(count)[self.first : self.last]


part = gathered(
    "part",
    Part,
    whole("--from", "First frame.", least=0, default=0, to="first"),
    whole("--to", "End: the frame after the last.", to="last"),
    recover,
)


@dataclass(frozen=True)
class Asked:
    """The object to find in recordings, and how to read them."""

    subject: Subject
    cameras: Cameras
    part: Part

    def options(self) -> tracker.recordings.Options:
        """The same for any process on any machine."""
        names: dict[str, Any] = {
            "start": self.part.first,
            "stop": self.part.last,
            "recover": self.part.recover,
        }
        names |= vars(self.cameras)
        return tracker.recordings.Options(self.subject.object_name, self.subject.colors_name, **names)


asked = gathered("asked", Asked, subject, cameras, part)
