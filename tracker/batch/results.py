"""The recordings of a batch, and the files of its results.

    a/b.dat.poses.h5       the poses
    a/b.dat.summary.json   their table row, and what they were made from
    a/b.dat.failed.json    instead of the row: why the last attempt failed; older poses may be left

The folder of results also holds files about the whole batch: options and recordings, the table, failures.

The small files are the only state of a batch, so any number of processes on any machines can add to it. They
contain no times or machine names: the same recordings give the same bytes.
"""

import contextlib
import glob
import json
import os
import shutil
from collections import deque
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import NoneType
from typing import Any

from tracker.errors import LogError
from tracker.files import read_bounded
from tracker.summaries.summary import COLUMNS


def recordings_of(given: Sequence[str], folder: Path) -> list[Path]:
    """Return the recordings given as paths or matched by patterns, in the given order.

    Matches of a pattern exclude results of earlier runs, so that a repeated command means the same wherever
    its folder of results is. A match reached through several links counts once. A pattern that is the name
    of an existing file or folder is a path. LogError if a pattern matches nothing.
    """
    found: list[str] = []
    results = os.path.realpath(folder)
    for one in given:
        fitting = [one]
        if glob.has_magic(one) and not os.path.exists(one):
            # Of several paths to one file or folder, prefer one without links, then the shortest, the first.
            ways = [(os.path.realpath(path), path) for path in _below("", one.split(os.sep), set())]
            ways.sort(key=lambda way: (way[0] != os.path.abspath(way[1]), way[1].count(os.sep), way[1]))
            once = dict(reversed(ways))
            fitting = sorted(path for real, path in once.items() if not _is_of_results(real, results))
        if not fitting:
            raise LogError(f"{one}: found nothing that fits this pattern, expected recordings")
        found += fitting
    return [Path(path) for path in found]


def _below(root: str, parts: list[str], been: set[tuple[int, int, int]]) -> Iterator[str]:
    """Yield the matches of a pattern below a folder; `**` matches any number of folders, each searched once.

    `glob` would follow a link to a parent folder again and again. `been` holds the folders already searched:
    number of remaining parts of the pattern, device, inode.
    """
    if "**" not in parts:
        found = glob.glob(os.sep.join(parts), root_dir=root or None) if any(parts) else [""]
        yield from filter(None, (os.path.join(root, path) for path in found))
        return
    at = parts.index("**")
    above, after = parts[:at], parts[at + 1 :]
    folders = deque(_below(root, above if any(above) else [*above, ""], been) if above else [root])
    links: deque[str] = deque()
    while folders or links:  # links last, so that their targets are found under their own names
        folder = folders.popleft() if folders else links.popleft()
        try:
            about = os.stat(folder or os.curdir)
            names = sorted(os.listdir(folder or os.curdir))
        except OSError:  # not a folder, or not readable
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
    """Whether a resolved path is the folder of results or a result in it."""
    with contextlib.suppress(OSError):
        return Path(path).is_relative_to(folder) and is_result(Path(path), Path(folder))
    return False


SUFFIX = ".poses.h5"
"""Suffix of a file of poses, after the name of its recording."""

_LINE, _REASON = ".summary.json", ".failed.json"

ASKED, TABLE, FAILURES = "batch.json", "summary", "failures.json"
"""Files of the folder of results: options and recordings, table (without suffix), failures."""

OF_ALL = (ASKED, f"{TABLE}.parquet", f"{TABLE}.csv", FAILURES)
"""All files that may be in the folder of results itself."""

IMAGES, STEPS, ZARR, REPORT = "images.parquet", "steps.parquet", "poses.zarr", "report.json"
"""Files in the folder of an image store's episodes, see `stores`."""

EPISODE = "episode-"
"""Prefix of the number in the name of an episode's file of poses, in a folder named like the store."""

OF_STORE = (IMAGES, STEPS, ZARR, REPORT)
"""All files about a whole image store."""

_FITTING = {str: (str, NoneType), int: (int, NoneType), float: (float, int, NoneType)}
"""Types of a table row's values, by the type of their column."""

MAX_FILE_SIZE = 100_000
"""Largest small file that is read [bytes]; they usually have 2 kB."""


def output_of(log: Path, folder: Path) -> Path:
    """Return the file of poses of a recording: `folder/a/b.dat.poses.h5` for `a/b.dat`.

    It depends on this recording only, so that others can be added later. Relative paths are mirrored as
    given; absolute ones and those with `..` are mirrored from the root of the file system.
    """
    path = Path(os.path.normpath(log))
    if path.is_absolute() or ".." in path.parts or not path.parts:
        path = Path(os.path.abspath(log))
        path = path.relative_to(path.anchor)
    return folder / path.parent / f"{path.name}{SUFFIX}"


def outputs_of(logs: Sequence[Path], folder: Path) -> list[Path]:
    """Return the file of poses of each recording; LogError if two recordings would share one."""
    given: dict[str, Path] = {}
    outputs: dict[Path, Path] = {}
    for log in logs:
        other = given.setdefault(os.path.abspath(log), log)
        if other is not log:
            raise LogError(f"{log}: found {other} too, expected each recording once")
        other = outputs.setdefault(output_of(log, folder), log)
        if other is not log:
            found = f"found {other} too, whose result has this name"
            raise LogError(f"{log}: {found}: give both as absolute paths")
    return list(outputs)


def output_of_episode(store: Path, number: int, folder: Path) -> Path:
    """Return an episode's file of poses: `folder/a/b.zarr/episode-00012.poses.h5` in store `a/b.zarr`."""
    output = output_of(store, folder)
    return output.with_name(output.name.removesuffix(SUFFIX)) / f"{EPISODE}{number:05d}{SUFFIX}"


def remove_tables(folder: Path) -> None:
    """Remove all files about a whole image store from the folder of its episodes."""
    shutil.rmtree(folder / ZARR, ignore_errors=True)
    for name in (IMAGES, STEPS, REPORT):
        (folder / name).unlink(missing_ok=True)


def summary_file(output: Path) -> Path:
    """Return the file with the table row for a file of poses."""
    return output.with_name(output.name.removesuffix(SUFFIX) + _LINE)


def failure_file(output: Path) -> Path:
    """Return the file that states why the last attempt failed."""
    return output.with_name(output.name.removesuffix(SUFFIX) + _REASON)


def is_result(path: Path, folder: Path) -> bool:
    """Whether a path is a file that batches write to their results, or a folder of these, or an empty one."""
    if path.name in OF_STORE and path.parent != folder:
        return True
    if path.is_dir() and not path.is_symlink():
        return all(is_result(entry, folder) for entry in path.iterdir() if not entry.name.startswith("."))
    return path.name.endswith((SUFFIX, _LINE, _REASON)) or (path.parent == folder and path.name in OF_ALL)


def read_line(output: Path) -> dict[str, Any] | None:
    """Return the table row for a file of poses; None if it is missing, damaged, or older than the poses."""
    path = summary_file(output)
    line = _read(path)
    if line is None:
        return None
    fits = (type(line.get(name, ...)) in _FITTING[kind] for name, kind in COLUMNS.items())
    if not all(fits) or any(isinstance(value, int) and abs(value) >= 2**63 for value in line.values()):
        return None
    with contextlib.suppress(OSError, UnicodeEncodeError):
        json.dumps(line, ensure_ascii=False).encode()  # no file holds half a pair of surrogates
        poses, about = output.stat(), path.stat()
        if poses.st_size == line.get("bytes") and poses.st_mtime_ns <= about.st_mtime_ns:
            return line
    return None


def read_failure(output: Path) -> str:
    """Return the reason why the last attempt failed; `unknown` if none is stored."""
    return str((_read(failure_file(output)) or {}).get("reason", "unknown"))


def _read(path: Path) -> dict[str, Any] | None:
    with contextlib.suppress(OSError, ValueError, RecursionError):
        if isinstance(content := json.loads(read_bounded(path, MAX_FILE_SIZE)), dict):
            return content
    return None
