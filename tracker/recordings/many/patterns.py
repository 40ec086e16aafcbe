"""Which recordings are meant: those that are named, and those that fit patterns such as `episodes/*`."""

from __future__ import annotations

import glob
import os
from collections.abc import Iterable, Sequence
from pathlib import Path

from tracker.errors import LogError
from tracker.recordings.many.results import is_result


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
    found = _each_once(glob.glob(given, recursive=True))
    results = os.path.realpath(folder)
    found = [path for path in found if not _is_of_results(os.path.realpath(path), results)]
    if not found:
        raise LogError(f"{given}: found nothing that fits this pattern, expected recordings")
    return found


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
