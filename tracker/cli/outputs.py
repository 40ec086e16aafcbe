"""Outputs of commands, checked before any work: invalid or destructive ones are refused."""

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import click
from click.core import augment_usage_errors

from tracker.errors import install
from tracker.files import check_suffix
from tracker.logs.layout import STAMPS_FILE
from tracker.logs.opening import JOB_LOGS, calibration_files, recording_files

IMAGES = {".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp"}
"""Suffixes of images that commands read."""

DRAWN = (".png", ".jpg", ".jpeg")
"""Suffixes of pictures that commands draw."""

_PACKAGES = {"plot": "matplotlib", "video": "av", "cluster": "pyarrow"}  # package for each extra


class AnyPath(click.Path):
    """A path that is not empty: otherwise, an unset variable would mean the working folder."""

    def __init__(self, path_type: type = Path) -> None:
        super().__init__(path_type=path_type)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """See click.ParamType."""
        if value == "":
            self.fail("found an empty path, expected a file or a folder", param, ctx)
        path: Any = super().convert(value, param, ctx)
        self.check(param.opts[0] if param else "output", path)
        return path

    def check(self, name: str, path: Path) -> None:
        """Raise click.ClickException if the path of option `name` is an invalid output."""


class InFile(AnyPath):
    """An input file or folder."""


class Recording(InFile):
    """An input recording or images, including the calibration and other files beside them."""


class OutFile(AnyPath):
    """A file to write, with one of the suffixes; `extra`: the extra whose package is needed."""

    def __init__(self, *suffixes: str, extra: str = "", new_folders: bool = False) -> None:
        super().__init__()
        self.suffixes, self.extra, self.new_folders = suffixes, extra, new_folders

    def check(self, name: str, path: Path) -> None:
        """See AnyPath."""
        check_suffix(path, self.suffixes, name, click.UsageError)
        if path.exists() and not path.is_file():
            found = "a folder" if path.is_dir() else "a pipe or a device"
            raise click.UsageError(f"{name} {path}: found {found}, expected a file")
        require_folder(name, path, parent_of(path), made=self.new_folders)
        package = _PACKAGES.get(self.extra)
        if package is not None and find_spec(package) is None:
            raise click.ClickException(f"{name} needs the package {package}: {install(self.extra)}")


class OutFolder(AnyPath):
    """A folder to write to; it is made, with its parents, if missing. `new`: it must be empty or missing."""

    def __init__(self, *, new: bool = False) -> None:
        super().__init__()
        self.new = new

    def check(self, name: str, path: Path) -> None:
        """See AnyPath."""
        if os.path.lexists(path) and not path.is_dir():
            found = "a file" if path.exists() else "a link to nothing"
            raise click.UsageError(f"{name} {path}: found {found}, expected a folder")
        require_folder(name, path, path, made=True)
        if self.new and path.is_dir() and any(path.iterdir()):
            raise click.UsageError(f"{name} {path}: in use, expected a new or an empty folder")


class Command(click.Command):
    """A command that refuses repeated recordings, and outputs that are inputs, from its parameters' types."""

    def invoke(self, ctx: click.Context) -> Any:
        """See click.Command."""
        files: dict[str, Path] = {}
        read: dict[bool, list[Path]] = {True: [], False: []}
        for param in self.params:
            value = ctx.params.get(param.name or "")
            if isinstance(param.type, OutFile) and value is not None:
                files[param.opts[0]] = value
            elif isinstance(param.type, InFile) and value is not None:
                several = value if isinstance(value, tuple) else (value,)
                read[isinstance(param.type, Recording)] += map(Path, several)
        with augment_usage_errors(ctx):
            refuse_repeated(filter(is_recording, read[True]))
            refuse_overwriting(files, read[True], read[False])
        return super().invoke(ctx)


def is_recording(path: str | Path) -> bool:
    """Whether a path given to a command is that of a recording, not of an image."""
    return Path(path).suffix.lower() not in IMAGES or Path(path).is_dir()


def refuse_repeated(recordings: Iterable[Path]) -> None:
    """Raise UsageError if a recording or image is given twice, since it would count as further evidence."""
    seen: dict[str, Path] = {}
    for path in recordings:
        other = seen.setdefault(os.path.realpath(path), path)
        if other is not path and path.exists():
            raise click.UsageError(f"{path}: found {other} again, expected another one")


def refuse_overwriting(
    files: Mapping[str, Path], recordings: Sequence[Path], others: Iterable[str | Path | None] = ()
) -> None:
    """Raise UsageError if an output (by option name) is an input, or the same file as another output.

    Files are compared, not names, so symbolic and hard links are resolved. The inputs are each recording,
    with its calibration and the files in its folder, and `others`: further files and folders, or None.
    """
    seen: dict[str, str] = {}
    for name, path in files.items():
        other = seen.setdefault(os.path.realpath(path), name)
        if other != name:
            raise click.UsageError(f"{name} {path}: found the same file as for {other}")
    existing: dict[object, str] = {
        identity: name for name, path in files.items() if (identity := _identity(path))
    }
    for kind, path in _inputs(recordings, others) if existing else ():
        if hit := existing.get(_identity(path)):
            raise click.UsageError(f"{hit} {files[hit]}: that is {kind}")
    # The next run would read these as an input folder's recording, or as images of it.
    opened = {os.path.realpath(recording): recording for recording in recordings if recording.is_dir()}
    folders = {real for real, one in opened.items() if not any((one / name).exists() for name in JOB_LOGS)}
    for name, path in files.items():
        parents = [str(parent) for parent in Path(os.path.realpath(path)).parents]
        if path.name in JOB_LOGS and (recording := opened.get(parents[0])):
            raise click.UsageError(
                f"{name} {path}: would be read in place of {recording}, expected another name"
            )
        read = path.suffix.lower() in (*DRAWN, ".mp4") or path.name == STAMPS_FILE
        if read and not folders.isdisjoint(parents):
            raise click.UsageError(f"{name} {path}: found a folder of images that are read, expected another")


def parent_of(path: Path) -> Path:
    """Return the folder that a file at the path is written to: for a link, that of its target."""
    return Path(os.path.realpath(path)).parent if path.is_symlink() else path.parent


def require_folder(name: str, path: Path, folder: Path, *, made: bool) -> None:
    """Raise UsageError unless `folder` is a writable folder or, if `made`, can be created.

    `name` and `path` are the option that needs the folder, and its value.
    """
    while made and not folder.exists():
        folder = folder.parent
    if not folder.is_dir():
        raise click.UsageError(f"{name} {path}: there is no folder {folder}")
    if not os.access(folder, os.W_OK):
        raise click.UsageError(f"{name} {path}: the folder {folder.absolute()} may not be written")


def _inputs(recordings: Sequence[Path], others: Iterable[str | Path | None]) -> Iterator[tuple[str, Path]]:
    for recording in filter(Path.exists, recordings):
        with suppress(OSError):  # opening it reports what cannot be read
            what = "the recording" if is_recording(recording) else "an input"
            for path in (recording, *recording_files(recording)):
                yield what, path
            folder = recording if recording.is_dir() else recording.parent
            for path in calibration_files(recording):
                yield "the recording's calibration", path
            for path in folder.glob("*.json"):
                yield "a file of the recording's folder", path
    for path in (Path(other) for other in others if other):
        for file in path.iterdir() if path.is_dir() else [path]:
            yield "an input", file


def _identity(path: Path) -> tuple[int, int] | None:
    """Return a file's device and inode, the same for all links to it; None if there is no file."""
    with suppress(OSError):
        about = path.stat()
        return about.st_dev, about.st_ino
    return None
