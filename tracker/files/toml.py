"""Small TOML files: your own by their paths, and those that come with the package by their names."""

from __future__ import annotations

import os
import sys
from collections.abc import Collection
from pathlib import Path
from typing import Any

from tracker.checks import naming, path_of
from tracker.errors import TrackerError, shown
from tracker.files import read_bounded, told_of

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

MAX_FILE_SIZE = 100_000
"""Largest such file [bytes]; those of objects, arenas and recordings have some hundred."""


def names_in(folder: Path) -> tuple[str, ...]:
    """Names of the files in a folder of the package, in order."""
    return tuple(sorted(path.stem for path in folder.glob("*.toml")))


def found_by(given: str | os.PathLike[str], folder: Path, what: str, fault: type[TrackerError]) -> Path:
    """The file in a folder of the package that has this name, or the one of this path; else `fault`."""
    path, names = path_of(given, what, fault), names_in(folder)
    if str(path) in names:
        return folder / f"{path}.toml"
    if path.suffix != ".toml":
        valid = ", ".join(names)
        raise fault(f"unknown {what} {shown(str(path))}; valid are {valid}, or the path of a .toml file")
    return path


def read_toml(
    path: Path, fault: type[TrackerError], keys: Collection[str] | None = None, what: str = ""
) -> dict[str, Any]:
    """The values of a file; `fault`, which names it, where it is no TOML or has others than these keys.

    keys: None: any. what: stands before the path.
    """
    where = f"{what} {path_of(path, what or 'file', fault)}".lstrip()
    with told_of(where, fault):
        content = read_bounded(path, MAX_FILE_SIZE)
    # Besides its own errors, the parser lets through those of numbers and of values nested too deeply.
    with naming(f"{where}: not a TOML file", fault, ValueError, RecursionError):
        values = tomllib.loads(content.decode("utf-8-sig"))
    if keys is not None and (unknown := sorted(set(values) - set(keys))):
        raise fault(f"{where}: found unknown key {unknown[0]!r}, expected some of {', '.join(keys)}")
    return values
