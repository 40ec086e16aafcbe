"""Small TOML files: those of the user by path, those of the package by name."""

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
"""Largest TOML file [bytes]; those of objects, arenas and recordings have a few hundred."""


def names_in(folder: Path) -> tuple[str, ...]:
    """Return the sorted names of the TOML files in a folder of the package."""
    return tuple(sorted(path.stem for path in folder.glob("[!.]*.toml")))


def found_by(given: str | os.PathLike[str], folder: Path, what: str, fault: type[TrackerError]) -> Path:
    """Return the file with this name in a folder of the package, or the given path; `fault` if neither."""
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
    """Return a file's values; raise `fault`, which names it, if it is not TOML or has unknown keys.

    keys: valid keys, None: any. what: text before the path in errors.
    """
    where = f"{what} {path_of(path, what or 'file', fault)}".lstrip()
    with told_of(where, fault):
        content = read_bounded(path, MAX_FILE_SIZE)
    # The parser also lets through errors of number conversion and of excessive nesting.
    with naming(f"{where}: not a TOML file", fault, ValueError, RecursionError):
        values = tomllib.loads(content.decode("utf-8-sig"))
    if keys is not None and (unknown := sorted(set(values) - set(keys))):
        raise fault(f"{where}: found unknown key {unknown[0]!r}, expected some of {', '.join(keys)}")
    return values
