"""Child Python processes, changes of environment variables, and ends by signals or with the parent."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Iterator, Mapping
from typing import Any


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


def end_with_parent() -> None:
    """From now on, end this process when its parent is gone, even in the middle of a task."""
    # Not at the top: commands that begin no process start sooner without it.
    from multiprocessing import connection, parent_process

    parent = parent_process()
    assert parent is not None

    def end() -> None:
        connection.wait([parent.sentinel])
        os._exit(1)

    threading.Thread(target=end, daemon=True).start()


class Ended(KeyboardInterrupt):
    """An interrupt by a signal other than SIGINT; its argument is the signal's number."""


def exit_code(stop: BaseException) -> int:
    """Return 128 plus the signal's number, as shells do."""
    return 128 + (stop.args[0] if isinstance(stop, Ended) else signal.SIGINT)


@contextlib.contextmanager
def ended_by_signals() -> Iterator[None]:
    """Turn SIGTERM and SIGHUP into interrupts, so that files are finished and locks released.

    If Python drops an interrupt because it came in a finalizer, the signal is sent again. Ignored signals
    stay ignored: `nohup` ignores SIGHUP. Nothing changes in threads other than the main one, which get no
    signals.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def end(number: int, _: object) -> None:
        raise Ended(number)

    def again(dropped: sys.UnraisableHookArgs) -> None:
        if not isinstance(dropped.exc_value, KeyboardInterrupt):
            hook(dropped)
            return
        # Send it to the main thread, to wake it up if it waits.
        main = threading.main_thread().ident
        threading.Timer(0.01, signal.pthread_kill, [main, exit_code(dropped.exc_value) - 128]).start()

    heeded = [n for n in (signal.SIGTERM, signal.SIGHUP) if signal.getsignal(n) is not signal.SIG_IGN]
    before, hook = {number: signal.signal(number, end) for number in heeded}, sys.unraisablehook
    sys.unraisablehook = again
    try:
        yield
    finally:
        sys.unraisablehook = hook
        for number, handler in before.items():
            signal.signal(number, handler)


@contextlib.contextmanager
def uninterrupted() -> Iterator[None]:
    """Defer signals that have a Python handler until the `with` block ends.

    For libraries that drop what a handler raises: HDF5 would then lose track of the file that it writes, and
    crash. Only the main thread receives signals, so nothing changes in others.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []
    before: dict[signal.Signals, Any] = {}
    try:
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            if callable(handler := signal.getsignal(number)):
                before[number] = handler
                signal.signal(number, lambda its, _: came.append(its))
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        if came:
            signal.raise_signal(came[0])
