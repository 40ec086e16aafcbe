"""Options that several commands of `python -m benchmarks` take."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import click

from benchmarks.data.scenes import OBJECTS
from benchmarks.data.store import CACHE
from benchmarks.data.workloads import BY_NAME

ROOT = Path(__file__).resolve().parent.parent
OUTPUT = ROOT / "build" / "benchmarks"

Command = Callable[..., None]

output = click.option(
    "-o",
    "--output",
    type=click.Path(file_okay=False, path_type=Path),
    default=OUTPUT,
    show_default="build/benchmarks",
    help="Folder of results.json and report.html.",
)
quick = click.option("--quick", is_flag=True, help="Few scenes: a smoke run, whose figures mean little.")
real = click.option(
    "--real",
    type=click.Path(file_okay=False, path_type=Path),
    default=lambda: os.environ.get("TRACKER_REAL_DATA", ROOT.parent / "shared" / "real"),
    help="Folder of recorded data; left out where it is absent.",
)
workers = click.option("--workers", default=2, show_default=True, help="Processes that render.")
cache = click.option(
    "--cache",
    type=click.Path(file_okay=False, path_type=Path),
    default=CACHE,
    envvar="TRACKER_BENCHMARK_CACHE",
    show_default="build/scenes",
    help="Folder of rendered scenes.",
)


def seed(default: int, what: str) -> Callable[[Command], Command]:
    """The seed of `what`."""
    return click.option(
        "--seed",
        type=click.IntRange(min=0),
        default=default,
        show_default=True,
        help=f"Of the {what}; nothing is ever adjusted with the default.",
    )


def scene_options(command: Command) -> Command:
    """What chooses workloads and objects, and how scenes are rendered and kept."""
    parts = (
        click.option(
            "--only",
            multiple=True,
            metavar="WORKLOAD",
            type=click.Choice(list(BY_NAME)),
            help=f"May be repeated: {', '.join(BY_NAME)}.",
        ),
        click.option(
            "--object", "objects", multiple=True, type=click.Choice(OBJECTS), help="May be repeated."
        ),
        workers,
        cache,
    )
    for option in reversed(parts):
        command = option(command)
    return command
