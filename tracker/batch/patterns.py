"""Which recordings are meant: those that are named, and those that fit patterns such as `episodes/*`."""

from __future__ import annotations

import glob
import os
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from tracker.batch.results import is_result
from tracker.errors import LogError


def recordings_of(given: Sequence[str], folder: Path) -> list[Path]:
    """The recordings that are named or fit a pattern, in the order of what is given.

    Of what fits a pattern the results of earlier runs are left out, so that the same command means the same
    again wherever its folder of results is; and what several links lead to is taken once.

    Args:
        given: paths and patterns; what is there under a pattern's own name is a path.
        folder: of the results.

    Raises:
        LogError: a pattern fits nothing.
    """
    return [Path(path) for one in given for path in _fitting(one, folder)]


def _fitting(given: str, folder: Path) -> list[str]:
    if os.path.exists(given) or not glob.has_magic(given):
        return [given]
    found = _each_once(_below("", given.split(os.sep), set()))
    results = os.path.realpath(folder)
    found = [path for path in found if not _is_of_results(os.path.realpath(path), results)]
    if not found:
        raise LogError(f"{given}: found nothing that fits this pattern, expected recordings")
    return found


def _below(root: str, parts: list[str], been: set[tuple[int, int, int]]) -> Iterator[str]:
    """What fits a pattern below a folder; `**` stands for any number of folders, each of which is seen once.

    `glob` would go through a link to a folder above anew for each link that it went through before.

    Args:
        root: the folder; empty: the present one.
        parts: the pattern's, between slashes.
        been: which folders were looked through: number of parts that were left, device, number on it.
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


def _each_once(paths: Iterable[str]) -> list[str]:
    """Of the paths that lead to one file or folder the one without links, the shortest, the first."""
    once: dict[str, str] = {}
    for path in sorted(paths, key=lambda path: (_has_links(path), path.count(os.sep), path)):
        once.setdefault(os.path.realpath(path), path)
    return sorted(once.values())


def _has_links(path: str) -> bool:
    return os.path.realpath(path) != os.path.abspath(path)


def _is_of_results(path: str, folder: str) -> bool:
    """Whether a path without links is the folder of results, or was made in it."""
    if path != folder and not path.startswith(folder + os.sep):
        return False
    try:
        return is_result(Path(path), Path(folder)) or (path == folder and not os.listdir(path))
    except OSError:
        return False
