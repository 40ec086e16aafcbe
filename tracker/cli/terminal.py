"""The commands' use of the terminal: text, progress bars and signals."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from itertools import zip_longest

import click


def table(rows: Sequence[Sequence[str]]) -> str:
    """Format rows as columns as wide as their widest cell, the first flush left, the others flush right."""
    widths = [max(map(len, column)) for column in zip_longest(*rows, fillvalue="")]
    lines = []
    for first, *others in rows:
        cells = [cell.rjust(width) for cell, width in zip(others, widths[1:], strict=False)]
        lines.append("  ".join([first.ljust(widths[0]), *cells]).rstrip())
    return "\n".join(lines)


def listing(rows: Sequence[Sequence[str]]) -> str:
    """Format lines with a label and a value each; values are aligned in one column."""
    widest = max(len(label) for label, _ in rows)
    # A file's name may contain line breaks: its other lines would look like labels.
    return "\n".join(f"{label:{widest}}  {' '.join(value.splitlines())}" for label, value in rows)


def say(message: str) -> None:
    """Print a message on one line of stderr, whatever names it contains; ignore a closed or full stderr."""
    with suppress(OSError):
        click.echo(f"tracker: {' '.join(message.split())}", err=True)


@contextmanager
def bar(label: str, total: int, quiet: bool, unit: str = "frames") -> Iterator[Callable[[int], None]]:
    """Yield a function that takes the number of items just done, and shows a bar if stderr is a terminal.

    The bar disappears when all is done or the `with` block ends, so that later messages start on a new line.
    """
    if quiet or sys.stderr is None or not sys.stderr.isatty():
        yield lambda _: None
        return
    from tqdm import tqdm

    tqdm.monitor_interval = 0  # no monitor thread
    with tqdm(total=total, desc=label, unit=f" {unit}", leave=False, dynamic_ncols=True) as shown:

        def advance(count: int) -> None:
            shown.update(count)
            if shown.n >= total:  # the work that follows may take long
                shown.close()

        yield advance


class Ended(KeyboardInterrupt):
    """An interrupt by a signal other than SIGINT; its argument is the signal's number."""


def exit_code(stop: BaseException) -> int:
    """Return 128 plus the signal's number, as shells do."""
    return 128 + (stop.args[0] if isinstance(stop, Ended) else signal.SIGINT)


@contextmanager
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
