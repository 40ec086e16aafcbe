"""Child Python processes with the same import path as this one, and changes of environment variables."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator, Mapping


def python_command(program: str, *arguments: str) -> list[str]:
    """Return the command that runs a program as `python -c` does, with arguments for its `sys.argv`.

    By default Python searches the current folder first, where a user's file may be named like a module.
    The command makes it search where this process does.
    """
    paths = [os.fspath(path) for path in sys.path]
    return [sys.executable, "-c", f"import sys; sys.path[:] = {paths}; {program}", *arguments]


@contextlib.contextmanager
def environment(values: Mapping[str, str]) -> Iterator[None]:
    """Set environment variables within the `with` block, and restore them after it."""
    before = {name: os.environ.get(name) for name in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
