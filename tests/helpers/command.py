"""The command `tracker`, and what it says of faults."""

import subprocess
from collections.abc import Callable
from pathlib import Path

from tests.helpers import ROOT, run_python

Run = Callable[..., subprocess.CompletedProcess[str]]
"""Gives what a command, or a script, printed and its exit code; `folder` is where it runs."""


def run(*arguments: object, folder: Path = ROOT) -> subprocess.CompletedProcess[str]:
    """Run the command in a process of its own."""
    return run_python(["-m", "tracker", *arguments], folder)


def well(result: subprocess.CompletedProcess[str]) -> subprocess.CompletedProcess[str]:
    """What a command printed that has to go well."""
    assert result.returncode == 0, result.stderr
    return result


def assert_one_line_error(result: subprocess.CompletedProcess[str], *words: str, code: int = 2) -> None:
    assert result.returncode == code, result.stderr
    assert result.stdout == ""
    assert result.stderr.startswith("tracker: ")
    assert len(result.stderr.splitlines()) == 1, result.stderr
    for word in words:
        assert word in result.stderr
