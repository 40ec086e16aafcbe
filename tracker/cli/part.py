"""The options that choose a part of a recording."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import click

_Command = TypeVar("_Command", bound=Callable[..., Any])

_FROM = click.option(
    "--from", "first", metavar="N", type=click.IntRange(0), default=0, help="First frame wanted."
)
_TO = click.option(
    "--to", "last", metavar="N", type=click.IntRange(1), help="First frame not wanted any more."
)


def part_options(command: _Command) -> _Command:
    """`--from` and `--to`; the command gets the numbers `first`, and `last` or None."""
    return _FROM(_TO(command))


def refuse_no_part(first: int, last: int | None) -> None:
    """Refuse a part that ends before it begins.

    Raises:
        click.UsageError: it does.
    """
    if last is not None and last <= first:
        raise click.UsageError(f"--from {first} --to {last}: expected --to beyond --from")
