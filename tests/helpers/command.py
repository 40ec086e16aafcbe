"""The command `tracker`, run or begun and not waited for, and what it says of faults."""

import io
import os
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from tests.helpers import ROOT, contents

Run = Callable[..., subprocess.CompletedProcess[str]]
"""Gives what a command, or a script, printed and its exit code; `folder` is where it runs."""


class Terminal(io.StringIO):
    """What is written to a terminal."""

    def isatty(self) -> bool:
        return True


def well(result: subprocess.CompletedProcess[str]) -> subprocess.CompletedProcess[str]:
    """What a command printed that has to go well."""
    assert result.returncode == 0, result.stderr
    return result


def assert_one_line_error(result: subprocess.CompletedProcess[str], *words: str, code: int = 2) -> None:
    assert result.returncode == code, result.stderr
    assert result.stdout == ""
    assert result.stderr.startswith("tracker: ")
    assert len(result.stderr.splitlines()) == 1, result.stderr
    assert [word for word in words if word not in result.stderr] == [], result.stderr


def assert_refused(run: Run, folder: Path, arguments: Sequence[object], *words: str, code: int = 2) -> None:
    """A command that runs in a folder fails with one line, and changes nothing there."""
    before = contents(folder)
    assert_one_line_error(run(*arguments, folder=folder), *words, code=code)
    assert contents(folder) == before


def begin(
    *arguments: object, program: str = "tracker", stderr: int = subprocess.PIPE
) -> subprocess.Popen[bytes]:
    """Begin a program with arguments, in a group of processes that can be ended together."""
    return subprocess.Popen(
        [sys.executable, "-m", program, *map(str, arguments)],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stderr=stderr,
        stdout=subprocess.PIPE,
        start_new_session=True,
    )


def until(holds: Callable[[], object], *processes: subprocess.Popen[bytes]) -> None:
    """Wait until something holds, while processes go on that are to bring it about."""
    deadline = time.monotonic() + 120
    while not holds():
        assert all(process.poll() is None for process in processes)
        assert time.monotonic() < deadline
        time.sleep(0.02)


def workers_of(process: subprocess.Popen[bytes]) -> list[int]:
    """Processes that a program has begun, or that it has left, and that still run."""
    listed = subprocess.check_output(["ps", "-wweo", "pid,pgid,stat,args"], text=True)
    rows = [line.split(None, 3) for line in listed.splitlines()[1:]]
    return [
        int(pid)
        for pid, group, state, what in rows
        if int(group) == process.pid and "spawn_main" in what and not state.startswith("Z")
    ]
