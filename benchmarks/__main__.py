"""Measure the tracker: `python -m benchmarks accuracy|speed|films|motion|rigs|dice|all|report|gate|…`."""

from __future__ import annotations

import sys

import click

from benchmarks.commands import accuracy, dice, everything, films, gate, motion, report, rigs, speed
from benchmarks.measure.likeness import main as likeness
from tracker.errors import TrackerError


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
def main() -> None:
    """Measure the tracker as its users would judge it."""


for command in (accuracy, speed, dice, films, motion, rigs, everything, report, gate):
    main.add_command(command)
main.add_command(likeness, "likeness")


if __name__ == "__main__":
    try:
        main()
    except TrackerError as error:
        click.echo(f"benchmarks: {error}", err=True)
        sys.exit(2)
