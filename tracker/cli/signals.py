"""Requests to end from outside: SIGINT, SIGTERM and SIGHUP."""

from __future__ import annotations

import contextlib
import signal
import sys
import threading
from collections.abc import Iterator

_AGAIN_SECONDS = 0.01


class Ended(KeyboardInterrupt):
    """An interrupt by a signal other than SIGINT."""

    def __init__(self, number: int) -> None:
        super().__init__()
        self.number = number


def exit_code(stop: BaseException) -> int:
    """128 and the signal's number, as shells have it."""
    return 128 + getattr(stop, "number", signal.SIGINT)


@contextlib.contextmanager
def ended_by_signals() -> Iterator[None]:
    """Being asked to end is an end like any other: files are finished, and claims on them given up.

    Where Python drops an interrupt, since it came within a finalizer, it comes again. What is ignored stays
    so: `nohup` has the terminal's end ignored. Of threads other than the main one, which get no signals,
    nothing changes.
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
        number = getattr(dropped.exc_value, "number", signal.SIGINT)
        # To that thread: it is to be woken where it waits.
        main = threading.main_thread().ident
        threading.Timer(_AGAIN_SECONDS, signal.pthread_kill, [main, number]).start()

    heeded = [n for n in (signal.SIGTERM, signal.SIGHUP) if signal.getsignal(n) is not signal.SIG_IGN]
    before, hook = {number: signal.signal(number, end) for number in heeded}, sys.unraisablehook
    sys.unraisablehook = again
    try:
        yield
    finally:
        sys.unraisablehook = hook
        for number, handler in before.items():
            signal.signal(number, handler)
