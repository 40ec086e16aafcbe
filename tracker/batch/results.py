"""Which recordings are meant, and what of them is done: a small file beside each file of poses.

    a/b.dat.poses.h5       the poses
    a/b.dat.summary.json   the line about them, and what they were made from
    a/b.dat.failed.json    instead of these: why there are none

The folder has those of all of them: what was asked for, the table, and what failed.

The small files are all that a batch remembers, so that any number of processes on any machines can add to
it. They hold no times and no names of machines: the same recordings give the same bytes.
"""

from __future__ import annotations

import glob
import json
import os
from collections import deque
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from tracker.errors import LogError
from tracker.files import read_bounded
from tracker.summaries.row import COLUMNS


def recordings_of(given: Sequence[str], folder: Path) -> list[Path]:
    """The recordings that are named or fit a pattern, in the order of what is given.

    Of what fits a pattern the results of earlier runs are left out, so that the same command means the same
    again wherever its folder of results is; and what several links lead to is taken once. What is there under
    a pattern's own name is a path.

    Raises:
        LogError: a pattern fits nothing.
    """
    found: list[str] = []
    results = os.path.realpath(folder)
    for one in given:
        fitting = [one]
        if glob.has_magic(one) and not os.path.exists(one):
            # What leads to one file or folder is taken without links, the shortest, the first.
            once: dict[str, str] = {}
            for path in sorted(_below("", one.split(os.sep), set()), key=_indirect):
                once.setdefault(os.path.realpath(path), path)
            fitting = sorted(path for real, path in once.items() if not _is_of_results(real, results))
        if not fitting:
            raise LogError(f"{one}: found nothing that fits this pattern, expected recordings")
        found += fitting
    return [Path(path) for path in found]


def _indirect(path: str) -> tuple[bool, int, str]:
    return os.path.realpath(path) != os.path.abspath(path), path.count(os.sep), path


def _below(root: str, parts: list[str], been: set[tuple[int, int, int]]) -> Iterator[str]:
    """What fits a pattern below a folder; `**` stands for any number of folders, each of which is seen once.

    `glob` would follow a link to a folder above again for each link that it followed before. `been` says
    which folders were looked through: number of parts that were left, device, number on it.
    """
    if "**" not in parts:
        found = glob.glob(os.sep.join(parts), root_dir=root or None) if any(parts) else [""]
        yield from filter(None, (os.path.join(root, path) for path in found))
        return
    at = parts.index("**")
    above, after = parts[:at], parts[at + 1 :]
    folders = deque(_below(root, above if any(above) else [*above, ""], been) if above else [root])
    links: deque[str] = deque()
    while folders or links:  # links last, so that what they lead to is found under its own name
        folder = folders.popleft() if folders else links.popleft()
        try:
            about = os.stat(folder or os.curdir)
            names = sorted(os.listdir(folder or os.curdir))
        except OSError:  # no folder, or none that may be read
            continue
        mark = (len(after), about.st_dev, about.st_ino)
        if mark in been:
            continue
        been.add(mark)
        if after:
            yield from _below(folder, after, been)
        elif folder:
            yield folder
        for path in (os.path.join(folder, name) for name in names if not name.startswith(".")):
            if os.path.isdir(path):
                (links if os.path.islink(path) else folders).append(path)
            elif not after:
                yield path


def _is_of_results(path: str, folder: str) -> bool:
    """Whether a path without links is the folder of results, or was made in it."""
    if path != folder and not path.startswith(folder + os.sep):
        return False
    try:
        return is_result(Path(path), Path(folder)) or (path == folder and not os.listdir(path))
    except OSError:
        return False


SUFFIX = ".poses.h5"
"""What the file of poses is called after its recording's name."""

_LINE, _REASON = ".summary.json", ".failed.json"

ASKED, TABLE, FAILURES = "batch.json", "summary", "failures.json"
"""In the folder of results: what was asked for, the table without its suffix, and what failed."""

OF_ALL = (ASKED, f"{TABLE}.parquet", f"{TABLE}.csv", FAILURES)
"""What is written in the folder itself."""

IMAGES, STEPS, ZARR, REPORT = "images.parquet", "steps.parquet", "poses.zarr", "report.json"
"""In the folder of the episodes of an image store, see `stores`."""

_EPISODE = "episode-"
"""What the file of poses of each episode is called before its number, in a folder called as the store."""

OF_STORE = (IMAGES, STEPS, ZARR, REPORT)
"""All of these."""

MAX_FILE_SIZE = 100_000
"""Largest file [bytes] that is read; they have 2 kB."""


def output_of(log: Path, folder: Path) -> Path:
    """The file of poses of a recording in a folder: `folder/a/b.dat.poses.h5` of `a/b.dat`.

    It depends on this recording alone, so that more of them can be added later. Relative paths are mirrored
    as they are given, others from the file system's root on.
    """
    path = Path(os.path.normpath(log))
    if path.is_absolute() or ".." in path.parts or not path.parts:
        path = Path(os.path.abspath(log))
        path = path.relative_to(path.anchor)
    return folder / path.parent / f"{path.name}{SUFFIX}"


def outputs_of(logs: Sequence[Path], folder: Path) -> list[Path]:
    """The file of poses of each recording; LogError where two recordings have the same."""
    given: dict[str, Path] = {}
    outputs: dict[Path, Path] = {}
    for log in logs:
        other = given.setdefault(os.path.abspath(log), log)
        if other is not log:
            raise LogError(f"{log}: found {other} too, expected each recording once")
        other = outputs.setdefault(output_of(log, folder), log)
        if other is not log:
            raise LogError(
                f"{log}: found {other} too, whose result has this name: give both as absolute paths"
            )
    return list(outputs)


def output_of_episode(store: Path, number: int, folder: Path) -> Path:
    """The file of poses of an episode of a store: `folder/a/b.zarr/episode-00012.poses.h5` of `a/b.zarr`."""
    output = output_of(store, folder)
    return output.with_name(output.name.removesuffix(SUFFIX)) / f"{_EPISODE}{number:05d}{SUFFIX}"


def is_episode(output: Path) -> bool:
    """Whether a file of poses is called like that of an episode."""
    return output.name.startswith(_EPISODE)


def summary_file(output: Path) -> Path:
    """Where the line about a file of poses is."""
    return output.with_name(output.name.removesuffix(SUFFIX) + _LINE)


def failure_file(output: Path) -> Path:
    """Where the reason is why there is no file of poses."""
    return output.with_name(output.name.removesuffix(SUFFIX) + _REASON)


def is_result(path: Path, folder: Path) -> bool:
    """Whether this is a file that batches write to their folder of results, or a folder of such."""
    if path.name in OF_STORE and path.parent != folder:
        return True
    if path.is_dir() and not path.is_symlink():
        inside = [entry for entry in path.iterdir() if not entry.name.startswith(".")]
        return bool(inside) and all(is_result(entry, folder) for entry in inside)
    return path.name.endswith((SUFFIX, _LINE, _REASON)) or (path.parent == folder and path.name in OF_ALL)


def read_line(output: Path) -> dict[str, Any] | None:
    """The line about a file of poses, which is there as it was when that was written; None: it is not."""
    path = summary_file(output)
    line = _read(path)
    if line is None or not COLUMNS.keys() <= line.keys():
        return None
    try:
        poses, about = output.stat(), path.stat()
    except OSError:
        return None
    same = poses.st_size == line.get("bytes") and poses.st_mtime_ns <= about.st_mtime_ns
    return line if same else None


def read_failure(output: Path) -> str:
    """Why there are no poses, as far as that is known."""
    return str((_read(failure_file(output)) or {}).get("reason", "unknown"))


def _read(path: Path) -> dict[str, Any] | None:
    try:
        content = json.loads(read_bounded(path, MAX_FILE_SIZE))
    except (OSError, ValueError, RecursionError):
        return None
    return content if isinstance(content, dict) else None
