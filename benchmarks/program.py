"""Measure the tracker: `python -m benchmarks all|accuracy|films|…|gate|compare|report`."""

import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import click

from benchmarks.data.plan import CACHE, DEVELOPMENT, FULL, Plan, release
from benchmarks.data.recorded import real_folder
from benchmarks.data.scenes import OBJECTS
from benchmarks.data.workloads import BY_NAME
from benchmarks.judge import compare as comparison
from benchmarks.judge import gate as gates
from benchmarks.judge.results import (
    Results,
    ResultsError,
    origin,
    read_results,
    write_published,
    write_results,
)
from benchmarks.judge.targets import judge
from benchmarks.measure.likeness import main as likeness
from benchmarks.measure.noise import measured as measured_noise
from benchmarks.report import documents
from benchmarks.report.documents import document
from benchmarks.report.plots import write_plots
from benchmarks.report.worst import again, write_worst
from benchmarks.run import OUTPUT, PARTS, Run, measure
from tracker.files import claimed

QUICK = 6
"""Number of scenes of a smoke run."""

Command = Callable[..., None]

_FOLDER = click.Path(file_okay=False, path_type=Path)

_FILE = click.Path(dir_okay=False, path_type=Path)

_output = click.option(
    "-o",
    "--output",
    type=_FOLDER,
    default=OUTPUT,
    show_default="build/benchmarks",
    help="Folder of results.json.",
)

_cache = click.option(
    "--cache",
    type=_FOLDER,
    default=CACHE,
    envvar="TRACKER_BENCHMARK_CACHE",
    show_default="build/scenes",
    help="Folder of rendered scenes.",
)

_workers = click.option(
    "--workers", type=click.IntRange(1, 256), default=2, show_default=True, help="Processes that render."
)

_real = click.option("--real", type=_FOLDER, help="Folder of recorded data; left out where it is absent.")

_OPTIONS = (
    click.option(
        "--scenes",
        type=click.IntRange(min=1),
        default=FULL,
        show_default=True,
        help="Realistic scenes per object; other workloads in proportion.",
    ),
    click.option("--quick", is_flag=True, help=f"A smoke run of {QUICK} scenes, whose figures mean little."),
    click.option(
        "--release",
        "released",
        is_flag=True,
        help="Draw new scenes from the commit's hash, as for publishing; else development scenes.",
    ),
    click.option("--seed", type=click.IntRange(min=0), help="Seed of other scenes than these two."),
    _real,
    _workers,
    _cache,
    click.option(
        "--only",
        multiple=True,
        metavar="WORKLOAD",
        type=click.Choice(list(BY_NAME)),
        help="Workload of the accuracy; may be repeated.",
    ),
    click.option("--object", "objects", multiple=True, type=click.Choice(OBJECTS), help="May be repeated."),
    _output,
)


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
def main() -> None:
    """Measure the tracker as its users would judge it."""


def _measuring(parts: Sequence[str], *, whole: bool = False, **chosen: Any) -> Results:
    draw, seed = _drawn(chosen["released"], chosen["seed"])
    scenes = QUICK if chosen["quick"] else chosen["scenes"]
    run = Run(
        Plan(scenes, seed, chosen["workers"], chosen["cache"]),
        chosen["output"],
        real_folder(chosen["real"]),
        objects=chosen["objects"] or None,
        draw=draw,
    )
    if chosen["only"]:
        run.workloads = [BY_NAME[name] for name in chosen["only"]]
    results = measure(run, parts, whole=whole)
    files = write_plots(results.frames, run.output)
    if run.draw == "development" and "accuracy" in results.frames:
        files.append(write_worst(results.frames["accuracy"], partial(again, run.plan), run.output))
    for file in files:
        run.say(str(file))
    return results


def _drawn(released: bool, seed: int | None) -> tuple[str, int]:
    if released and seed is not None:
        raise ResultsError(f"seed: found {seed}, expected none: release scenes are drawn from the commit")
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
        results = _measuring([name], **chosen)
        click.echo(document(results.about, results.figures, judge(results)))

    run.__doc__ = PARTS[name].__doc__
    return _with_options(run)


for part in PARTS:
    main.command(name=part.replace("_", "-"))(_command(part))


@main.command(name="all")
@click.option(
    "--publish",
    is_flag=True,
    help="Of release scenes; writes benchmarks/results.md, README.md's and docs/figures.md's figures.",
)
@_with_options
def everything(publish: bool, **chosen: Any) -> None:
    """Measure every part. The same command continues an interrupted run."""
    chosen["released"] = chosen["released"] or publish
    results = _measuring(list(PARTS), whole=True, **chosen)
    judged = judge(results)
    if publish:
        write_published(documents.PUBLISHED, results, judged)
        documents.write_documents(documents.read_published())
    else:
        click.echo(document(results.about, results.figures, judged))


@main.command()
@_output
def report(output: Path) -> None:
    """Print the results of a folder."""
    results = read_results(output)
    click.echo(document(results.about, results.figures, judge(results)))


@main.command()
@click.argument("before", type=click.Path(exists=True, path_type=Path))
@click.argument("after", type=click.Path(exists=True, path_type=Path))
def compare(before: Path, after: Path) -> None:
    """Compare two runs on the same images, answer by answer: files of results, or their folders."""
    click.echo(comparison.text(comparison.compare(read_results(before), read_results(after))))


@main.command()
@click.option("-o", "--output", type=_FOLDER, default=OUTPUT.with_name("gate"), show_default="build/gate")
@_cache
@_real
@click.option("--baseline", type=_FILE, default=gates.BASELINE, show_default="benchmarks/judge/gate.json")
@click.option("--update", default="", metavar="REASON", help="Make these results the baseline, and say why.")
def gate(output: Path, cache: Path, real: Path | None, baseline: Path, update: str) -> None:
    """Fail where few scenes, or the recorded triplets, show something worse than the baseline."""
    run = Run(gates.plan(cache), output, real_folder(real), gates.WORKLOADS, films=gates.FILMS)
    before = Results() if update else read_results(baseline)
    results = measure(run, ["gate"], whole=True)
    if update:
        if not results.about["clean"]:
            raise ResultsError(
                "baseline: the tree has changes that are not committed; commit them and measure"
            )
        results.about["reason"] = update
        write_results(baseline, results)
        return
    click.echo(f"baseline of {before.about['commit'][:12]}: {before.about.get('reason', 'no reason given')}")
    worse = gates.failures(before, results)
    for line in worse:
        click.echo(f"worse: {line}")
    if worse:
        sys.exit(1)
    click.echo("nothing is worse than the baseline allows")


@main.command()
@click.option("--object", "name", type=click.Choice(OBJECTS), default=OBJECTS[0], show_default=True)
@click.option("--seed", type=click.IntRange(min=0), default=DEVELOPMENT, help="Seed of the fitted films.")
@click.option("--check", type=click.IntRange(min=0), default=4242, help="Seed of those that check.")
@click.option("--refined", is_flag=True, help="With cameras as a refinement leaves them.")
@_workers
@_cache
@click.option("-o", "--output", type=_FILE, default=Path("noise.toml"), show_default=True)
def noise(name: str, seed: int, check: int, refined: bool, workers: int, cache: Path, output: Path) -> None:
    """Measure the tracker's errors on films, and write them as a model for simulators."""
    plan = Plan(seed=seed, workers=workers, cache=cache)
    with claimed(output):  # before hours are spent
        click.echo(measured_noise(name, plan, check, output, refined=refined))


main.add_command(likeness, "likeness")
