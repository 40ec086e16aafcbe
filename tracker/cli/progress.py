"""A bar that says how far a long task is, for those who watch."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def bar(label: str, total: int, quiet: bool, unit: str = "frames") -> Iterator[Callable[[int], None]]:
    """A function that is told how many more are done; a bar on stderr shows it, if that is a terminal.

    The bar is gone when the `with` block ends, however it ends, so that what is said next has its own line.
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

        yield advance
