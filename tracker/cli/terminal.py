"""The commands' use of the terminal: text and progress bars."""

import sys
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
