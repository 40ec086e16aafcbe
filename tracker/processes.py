"""Other processes of this Python: they import what this one imports, and see its variables."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator, Mapping


def python_command(program: str, *arguments: str) -> list[str]:
    """The command that runs a program as `python -c` does, with arguments for its `sys.argv`.

    By itself Python looks for modules in the present folder first, where a user may have a file that is
    called as one of them. Here it looks where this process does.
    """
    paths = [os.fspath(path) for path in sys.path]
    return [sys.executable, "-c", f"import sys; sys.path[:] = {paths}; {program}", *arguments]


@contextlib.contextmanager
def environment(values: Mapping[str, str]) -> Iterator[None]:
    """Variables of the environment that have these values within the `with` block."""
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
