"""Small TOML files."""

from __future__ import annotations

import os
import sys
from collections.abc import Collection
from typing import Any

from tracker.errors import TrackerError

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

MAX_FILE_SIZE = 100_000
"""Largest such file [bytes]; those of objects, arenas and recordings have some hundred."""


def parse_toml(
    content: bytes,
    where: str | os.PathLike[str],
    fault: type[TrackerError],
    keys: Collection[str] | None = None,
) -> dict[str, Any]:
    """The values of a file; `fault`, which names it, where it is no TOML or has others than these keys.

    keys: None: any.
    """
    try:
        values = tomllib.loads(content.decode("utf-8-sig"))
    # Besides its own errors, the parser lets through those of numbers and of values nested too deeply.
    except (ValueError, RecursionError) as error:
        raise fault(f"{os.fspath(where)}: not a TOML file: {' '.join(str(error).split())}") from error
    if keys is not None and (unknown := sorted(set(values) - set(keys))):
        raise fault(
            f"{os.fspath(where)}: found unknown key {unknown[0]!r}, expected some of {', '.join(keys)}"
        )
    return values
