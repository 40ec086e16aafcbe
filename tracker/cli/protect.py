"""Outputs that would destroy something are refused before any work is done."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

import click

_PICTURES = (".png", ".jpg", ".jpeg", ".mp4")
_HDF5 = b"\x89HDF\r\n\x1a\n"


def refuse_overwriting(
    files: Mapping[str, Path],
    recordings: Sequence[Path],
    others: Iterable[str | Path | None] = (),
    *,
    new_folders: bool = False,
) -> None:
    """Refuse outputs that are an input, or the same file, or whose folder is missing.

    Files are compared, not names: links, of either kind, are followed.

    Args:
        files: the outputs, by the option that names them.
        recordings: inputs; with each of them its calibration is one, and all of its folder.
        others: files and folders that are read too, such as a calibration; None or names that are no file
            are passed over.
        new_folders: whether folders that are missing will be made.

    Raises:
        click.UsageError: an output is refused.
    """
    seen: dict[str, str] = {}
    for name, path in files.items():
        if path.is_dir():
            raise click.UsageError(f"{name} {path}: found a folder, expected a file")
        if not new_folders and not path.parent.is_dir():
            raise click.UsageError(f"{name} {path}: there is no folder {path.parent}")
        other = seen.setdefault(os.path.realpath(path), name)
        if other != name:
            raise click.UsageError(f"{name} {path}: found the same file as for {other}")
    existing = {identity: name for name, path in files.items() if (identity := _identity(path))}
    if existing:
        for kind, path in _inputs(recordings, others):
            hit = existing.get(_identity(path) or (0, 0))
            if hit is not None:
                raise click.UsageError(f"{hit} {files[hit]}: that is {kind}")
    _refuse_pictures(files, recordings)


def check_suffix(name: str, path: Path, *suffixes: str) -> None:
    """Refuse a file whose name says that it is something else.

    Raises:
        click.UsageError: the suffix is none of these.
    """
    if path.suffix.lower() not in suffixes:
        found = f"suffix {path.suffix!r}" if path.suffix else "no suffix"
        raise click.UsageError(f"{name} {path}: found {found}, expected {' or '.join(suffixes)}")


def refuse_file(name: str, path: Path) -> None:
    """Refuse a folder of outputs that is a file.

    Raises:
        click.UsageError: it is one.
    """
    if path.exists() and not path.is_dir():
        raise click.UsageError(f"{name} {path}: found a file, expected a folder")


def refuse_other_content(name: str, path: Path) -> None:
    """Refuse to replace a file that is no file of poses; one that is damaged may be replaced.

    Raises:
        click.UsageError: it is something else.
    """
    from tracker.files.hdf5 import open_file
    from tracker.poses.file import is_poses_file

    if not path.is_file() or path.stat().st_size == 0 or is_poses_file(path):
        return
    with path.open("rb") as file:
        ours = file.read(len(_HDF5)) == _HDF5
    if ours:
        with suppress(OSError, RuntimeError), open_file(path):
            ours = False
    if not ours:
        raise click.UsageError(f"{name} {path}: found a file that holds no poses, expected another name")


def _inputs(recordings: Sequence[Path], others: Iterable[str | Path | None]) -> Iterator[tuple[str, Path]]:
    """All files that are read, and what they are."""
    from tracker.logs.opening import calibration_files, recording_files

    for recording in recordings:
        with suppress(OSError):  # what cannot be read is told when it is opened
            for path in (recording, *recording_files(recording)):
                yield "the recording", path
            folder = recording if recording.is_dir() else recording.parent
            for path in calibration_files(recording):
                yield "the recording's calibration", path
            for path in folder.glob("*.json"):
                yield "a file of the recording's folder", path
    for other in others:
        path = Path(other or "")
        if other and path.is_dir():
            for file in path.iterdir():
                yield "an input", file
        elif other:
            yield "an input", path


def _refuse_pictures(files: Mapping[str, Path], recordings: Sequence[Path]) -> None:
    """Refuse pictures and films in a folder of such, of which they would be some the next time."""
    from tracker.logs.opening import JOB_LOGS

    folders = {
        os.path.realpath(recording)
        for recording in recordings
        if recording.is_dir() and not any((recording / name).exists() for name in JOB_LOGS)
    }
    for name, path in files.items():
        inside = folders & {str(parent) for parent in Path(os.path.realpath(path)).parents}
        if inside and path.suffix.lower() in _PICTURES:
            raise click.UsageError(f"{name} {path}: found the recording's folder of images, expected another")


def _identity(path: Path) -> tuple[int, int] | None:
    """What all links to a file have in common; None: there is none."""
    try:
        about = path.stat()
    except OSError:
        return None
    return about.st_dev, about.st_ino
