"""Other processes of this Python, which import what this one imports."""

from __future__ import annotations

import os
import sys


def python_command(program: str, *arguments: str) -> list[str]:
    """The command that runs a program as `python -c` does, with arguments for its `sys.argv`.

    By itself Python looks for modules in the present folder first, where a user may have a file that is
    called as one of them. Here it looks where this process does.
    """
    paths = [os.fspath(path) for path in sys.path]
    return [sys.executable, "-c", f"import sys; sys.path[:] = {paths}; {program}", *arguments]
