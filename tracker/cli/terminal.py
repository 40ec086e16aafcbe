"""What commands and the terminal have to do with each other: text, progress, and requests to end."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import zip_longest

import click


def table(rows: Sequence[Sequence[str]]) -> str:
    """Lines of cells in columns as wide as their widest cell: the first flush left, the others right."""
    widths = [max(map(len, column)) for column in zip_longest(*rows, fillvalue="")]
    lines = []
    for first, *others in rows:
        cells = [cell.rjust(width) for cell, width in zip(others, widths[1:], strict=False)]
        lines.append("  ".join([first.ljust(widths[0]), *cells]).rstrip())
    return "\n".join(lines)


def listing(rows: Sequence[Sequence[str]]) -> str:
    """Lines of a label and a value, the values flush left below each other."""
    widest = max(len(label) for label, _ in rows)
    # A file's name may have several lines, which would be read as other labels.
    return "\n".join(f"{label:{widest}}  {' '.join(value.splitlines())}" for label, value in rows)


def say(message: str) -> None:
    """Print a message on stderr, in one line whatever names it contains."""
    click.echo(f"tracker: {' '.join(message.split())}", err=True)


@contextmanager
def bar(label: str, total: int, quiet: bool, unit: str = "frames") -> Iterator[Callable[[int], None]]:
    """A function that takes how many more are done; a bar on stderr shows it, if that is a terminal.

    The bar is gone when all is done or the `with` block ends, so that later messages have their own line.
    """
    if quiet or sys.stderr is None or not sys.stderr.isatty():
        yield lambda _: None
        return
    from tqdm import tqdm

    # Without the thread that would look after a bar which nobody moves.
    tqdm.monitor_interval = 0
    with tqdm(
        total=total, desc=label, unit=f" {unit}", leave=False, dynamic_ncols=True, file=sys.stderr
    ) as shown:

        def advance(count: int) -> None:
            shown.update(count)
            if shown.n >= total:  # what follows may take long
                shown.close()

        yield advance


class Ended(KeyboardInterrupt):
    """An interrupt by a signal other than SIGINT, whose number it has."""


def exit_code(stop: BaseException) -> int:
    """128 and the signal's number, as shells have it."""
    return 128 + (stop.args[0] if isinstance(stop, Ended) else signal.SIGINT)


@contextmanager
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
        # To that thread: it is to be woken where it waits.
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
