"""Small TOML files."""

import sys
from collections.abc import Collection
from pathlib import Path
from typing import Any

from tracker.checks import naming, path_of
from tracker.errors import TrackerError
from tracker.files import read_bounded, reading

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

MAX_FILE_SIZE = 100_000
"""Largest TOML file [bytes]; those of objects, arenas and recordings have a few hundred."""


def read_toml(
    path: Path, fault: type[TrackerError], keys: Collection[str] | None = None, what: str = ""
) -> dict[str, Any]:
    """Return a file's values; raise `fault`, which names it, if it is not TOML or has unknown keys.

    keys: valid keys, None: any. what: text before the path in errors.
    """
    where = f"{what} {path_of(path, what or 'file', fault)}".lstrip()
    with reading(where, fault):
        content = read_bounded(path, MAX_FILE_SIZE)
    # The parser also lets through errors of number conversion and of excessive nesting.
    with naming(f"{where}: not a TOML file", fault, ValueError, RecursionError):
        values = tomllib.loads(content.decode("utf-8-sig"))
    if keys is not None and (unknown := sorted(set(values) - set(keys))):
        raise fault(f"{where}: found unknown key {unknown[0]!r}, expected some of {', '.join(keys)}")
    return values
