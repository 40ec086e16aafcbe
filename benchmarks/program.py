"""Measure the tracker: `python -m benchmarks accuracy|speed|films|motion|dice|all|report|gate|…`."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import click

from benchmarks.commands import OUTPUT, PARTS, Run, measure
from benchmarks.data.robots import real_folder
from benchmarks.data.scenes import OBJECTS
from benchmarks.data.seeds import DEVELOPMENT, release
from benchmarks.data.sets import FULL, Plan
from benchmarks.data.store import CACHE
from benchmarks.data.workloads import BY_NAME, WORKLOADS
from benchmarks.judge import ci
from benchmarks.judge import gate as gates
from benchmarks.judge.compare import compare as compared
from benchmarks.judge.origin import origin
from benchmarks.judge.results import Results, ResultsError, read_results, write_results
from benchmarks.measure.likeness import main as likeness
from benchmarks.report import readme
from benchmarks.report.document import markdown, table_markdown, write_report
from benchmarks.report.table import specification, tables_of
from tracker.files import write_whole

PUBLISHED = Path(__file__).with_name("results.md")

QUICK = 6
"""Scenes of a smoke run."""

Command = Callable[..., None]

_FOLDER = click.Path(file_okay=False, path_type=Path)

_FILE = click.Path(dir_okay=False, path_type=Path)

_output = click.option(
    "-o",
    "--output",
    type=_FOLDER,
    default=OUTPUT,
    show_default="build/benchmarks",
    help="Folder of results.json and report.html.",
)

_OPTIONS = (
    click.option(
        "--scenes",
        type=click.IntRange(min=1),
        default=FULL,
        show_default=True,
        help="Realistic scenes of an object; of everything else there are so many in proportion.",
    ),
    click.option("--quick", is_flag=True, help=f"A smoke run of {QUICK} scenes, whose figures mean little."),
    click.option(
        "--release",
        "released",
        is_flag=True,
        help="Draw scenes anew from the commit's hash, as for publishing; else development scenes.",
    ),
    click.option("--seed", type=click.IntRange(min=0), help="Of other scenes than these two."),
    click.option("--real", type=_FOLDER, help="Folder of recorded data; left out where it is absent."),
    click.option("--workers", default=2, show_default=True, help="Processes that render."),
    click.option(
        "--cache",
        type=_FOLDER,
        default=CACHE,
        envvar="TRACKER_BENCHMARK_CACHE",
        show_default="build/scenes",
        help="Folder of rendered scenes.",
    ),
    click.option(
        "--only",
        multiple=True,
        metavar="WORKLOAD",
        type=click.Choice(list(BY_NAME)),
        help="Of the accuracy; may be repeated.",
    ),
    click.option("--object", "objects", multiple=True, type=click.Choice(OBJECTS), help="May be repeated."),
    _output,
)


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
def main() -> None:
    """Measure the tracker as its users would judge it."""


def _measuring(parts: Sequence[str], **chosen: Any) -> Results:
    draw, seed = _drawn(chosen["released"], chosen["seed"])
    scenes = QUICK if chosen["quick"] else chosen["scenes"]
    run = Run(
        Plan(scenes, seed, chosen["workers"], chosen["cache"]),
        chosen["output"],
        real_folder(chosen["real"]),
        [BY_NAME[name] for name in chosen["only"]] or WORKLOADS,
        chosen["objects"] or None,
        Results({"draw": draw}),
    )
    return measure(run, parts)


def _drawn(released: bool, seed: int | None) -> tuple[str, int]:
    if seed is not None:
        return "other", seed
    if not released:
        return "development", DEVELOPMENT
    here = origin()
    if not here["clean"]:
        raise ResultsError("release scenes are drawn from a commit: the tree has changes; commit them first")
    return "release", release(here["commit"])


def _with_options(command: Command) -> Command:
    for option in reversed(_OPTIONS):
        command = option(command)
    return command


def _command(name: str) -> Command:
    def run(**chosen: Any) -> None:
        click.echo(markdown(_measuring([name], **chosen)))

    run.__doc__ = PARTS[name].__doc__
    return _with_options(run)


for part in PARTS:
    main.command(name=part)(_command(part))


@main.command(name="all")
@click.option(
    "--publish", is_flag=True, help="Of release scenes; writes benchmarks/results.md and README.md's figures."
)
@_with_options
def everything(publish: bool, **chosen: Any) -> None:
    """Measure every part, and write the report."""
    chosen["released"] = chosen["released"] or publish
    results = _measuring(list(PARTS), **chosen)
    click.echo(f"{write_report(chosen['output'])}", err=True)
    if publish:
        write_whole(PUBLISHED, markdown(results))
        write_results(readme.PUBLISHED, Results(results.about, results.rows))
        readme.write_figures(results)
    else:
        click.echo(markdown(results))


@main.command()
@_output
def report(output: Path) -> None:
    """Write report.html from the results of a folder."""
    click.echo(write_report(output))


@main.command()
@_output
@click.option(
    "--baseline",
    type=_FILE,
    default=gates.BASELINE,
    show_default="benchmarks/judge/baseline.json",
    help="What the results are compared with.",
)
@click.option("--update", is_flag=True, help="Make these results the baseline; needs a reason.")
@click.option("--reason", default="", help="Why the baseline is replaced.")
def gate(output: Path, baseline: Path, update: bool, reason: str) -> None:
    """Fail where a figure has fallen by more than its tolerance since the baseline."""
    results = read_results(output)
    if update:
        gates.write_baseline(results, reason, baseline)
        return
    before = gates.read_baseline(baseline)
    click.echo(f"baseline of {before['commit'][:12]}: {before['reason']}")
    _verdict(gates.failures(before, results))


@main.command()
@click.argument("before", type=click.Path(exists=True, path_type=Path))
@click.argument("after", type=click.Path(exists=True, path_type=Path))
def compare(before: Path, after: Path) -> None:
    """Compare two runs of the same scenes, scene by scene: files of results, or their folders."""
    rows = compared(read_results(before), read_results(after))
    for table in tables_of(specification()["compared"], Results(rows=rows)):
        click.echo(table_markdown(table))


@main.command()
@click.option("-o", "--output", type=_FOLDER, default=OUTPUT / "small", show_default="build/benchmarks/small")
@click.option("--cache", type=_FOLDER, default=CACHE, envvar="TRACKER_BENCHMARK_CACHE")
@click.option("--real", type=_FOLDER, help="Folder of recorded data.")
@click.option("--baseline", type=_FILE, default=ci.BASELINE)
@click.option("--update", is_flag=True, help="Make these results the baseline; needs a reason.")
@click.option("--reason", default="", help="Why the baseline is replaced.")
def small(output: Path, cache: Path, real: Path | None, baseline: Path, update: bool, reason: str) -> None:
    """The gate in a minute: few rendered scenes and the recorded triplets against their own baseline."""
    run = Run(ci.plan(cache), output, real_folder(real), ci.WORKLOADS, results=Results({"draw": "small"}))
    results = measure(run, ("accuracy", "agreement"), anew=True)
    if update:
        gates.check_origin(results, reason)
        results.about["reason"] = reason
        write_results(baseline, results)
        return
    before = read_results(baseline)
    click.echo(f"baseline of {before.about['commit'][:12]}: {before.about['reason']}")
    _verdict([*gates.doubts(results), *ci.failures(before, results)])


def _verdict(worse: Sequence[str]) -> None:
    for line in worse:
        click.echo(f"worse: {line}")
    if worse:
        sys.exit(1)
    click.echo("nothing has fallen by more than its tolerance")


main.add_command(likeness, "likeness")
