"""Being asked to end from outside."""

from __future__ import annotations

import contextlib
import signal
import sys
import threading
from collections.abc import Iterator

_AGAIN_SECONDS = 0.01


@contextlib.contextmanager
def ended_by_signals() -> Iterator[None]:
    """Being asked to end is an end like any other: files are finished, and claims on them given up.

    Where Python drops an interrupt, since it came within a finalizer, it comes again. Of threads other than
    the main one, which get no signals, nothing changes.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def end(*_: object) -> None:
        raise KeyboardInterrupt

    def again(dropped: sys.UnraisableHookArgs) -> None:
        if not isinstance(dropped.exc_value, KeyboardInterrupt):
            hook(dropped)
            return
        main = threading.main_thread().ident
        threading.Timer(_AGAIN_SECONDS, _interrupt, [main]).start()

    before, hook = signal.signal(signal.SIGTERM, end), sys.unraisablehook
    sys.unraisablehook = again
    try:
        yield
    finally:
        sys.unraisablehook = hook
        signal.signal(signal.SIGTERM, before)


def _interrupt(thread: int) -> None:
    if hasattr(signal, "pthread_kill"):  # which wakes a thread that waits, too
        signal.pthread_kill(thread, signal.SIGINT)
    else:
        signal.raise_signal(signal.SIGINT)
