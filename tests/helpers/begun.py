"""The command in a process of its own, begun and not waited for."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable

from tests.helpers import ROOT


def begin(*arguments: object) -> subprocess.Popen[bytes]:
    """Begin `tracker` with arguments, in a group of processes that can be ended together."""
    return subprocess.Popen(
        [sys.executable, "-m", "tracker", *map(str, arguments)],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stderr=subprocess.PIPE,
        stdout=subprocess.PIPE,
        start_new_session=True,
        # A test run in the background hands on that Ctrl-C is ignored; a terminal's command does not.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )


def until(holds: Callable[[], object], *processes: subprocess.Popen[bytes]) -> None:
    """Wait until something holds, while processes go on that are to bring it about."""
    deadline = time.monotonic() + 120
    while not holds():
        assert all(process.poll() is None for process in processes)
        assert time.monotonic() < deadline
        time.sleep(0.02)
