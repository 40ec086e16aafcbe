"""The commands of `python -m benchmarks`: each adds its part to the results of a folder."""

from __future__ import annotations

import dataclasses
import platform
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

import tracker
from benchmarks import command_options as option
from benchmarks.command_options import ROOT
from benchmarks.data.dice import SEED as DICE_SEED
from benchmarks.data.films import SEED as FILM_SEED
from benchmarks.data.motion import SEED as MOTION_SEED
from benchmarks.data.rig_cases import CASES
from benchmarks.data.rig_scenes import SEED as RIG_SEED
from benchmarks.data.scenes import OBJECTS, SEED
from benchmarks.data.workloads import BY_NAME, FULL, QUICK, WORKLOADS, Workload
from benchmarks.judge import gate as gates
from benchmarks.judge.targets import evaluate
from benchmarks.measure.accuracy import AccuracyOptions, AccuracyRun, again, measure_accuracy, without_package
from benchmarks.measure.dice import QUICK as QUICK_DICE
from benchmarks.measure.dice import DiceOptions, measure_dice
from benchmarks.measure.films import QUICK as QUICK_FILMS
from benchmarks.measure.films import FilmOptions, measure_films
from benchmarks.measure.motion import QUICK as QUICK_MOTION
from benchmarks.measure.motion import MotionOptions, measure_motion
from benchmarks.measure.recorded import pose_rows, segmentation_rows
from benchmarks.measure.rigs import RigOptions, measure_rigs
from benchmarks.measure.speed import QUICK as QUICK_SPEED
from benchmarks.measure.speed import measure_speed
from benchmarks.report import write_report
from benchmarks.report.dice_tables import dice_targets
from benchmarks.report.dice_worst import write_worst_dice
from benchmarks.report.film_plot import write_film_plot
from benchmarks.report.film_tables import film_targets
from benchmarks.report.tables import results_markdown
from benchmarks.report.worst import Shown, worst_pictures
from benchmarks.score.records import (
    RESULTS_FILE,
    FrameRecord,
    Results,
    ResultsError,
    read_results,
    records_of,
    select,
    write_results,
)
from tracker.files import write_whole

PUBLISHED = Path(__file__).with_name("results.md")

DRAWS = {False: 200, True: 5}
"""Draws of light for the recorded triplets, by whether the run is quick."""


@click.command()
@option.quick
@option.real
@option.output
@option.scene_options
def accuracy(quick: bool, real: Path, output: Path, **chosen: Any) -> None:
    """Errors, misses, confidence and covariance on all workloads; recorded images where there are any."""
    results = _begun(output, quick)
    _add_accuracy(results, output, _options(quick, **chosen), real)
    _finish(results, output)


@click.command()
@option.quick
@option.real
@option.output
def speed(quick: bool, real: Path, output: Path) -> None:
    """Time by stage, cameras, resolution and faces in view; start-up and memory."""
    results = _begun(output, quick)
    _add_speed(results, quick, real)
    _finish(results, output)


@click.command()
@option.quick
@option.real
@option.output
@option.workers
@option.cache
@option.seed(DICE_SEED, "scenes")
def dice(quick: bool, real: Path, output: Path, workers: int, cache: Path, seed: int) -> None:
    """Masks, positions and time of the dice task; the recorded picture where there is one."""
    results = _begun(output, quick)
    _add_dice(results, output, _dice_options(quick, workers, cache, seed), real)
    _finish(results, output)


@click.command()
@option.quick
@option.output
@option.workers
@option.cache
@option.seed(FILM_SEED, "films")
def films(quick: bool, output: Path, workers: int, cache: Path, seed: int) -> None:
    """Tracking over time: accuracy, losses, single cameras, a vanishing object, and time."""
    results = _begun(output, quick)
    _add_films(results, output, _film_options(quick, workers, cache, seed))
    _finish(results, output)


@click.command()
@option.output
@option.workers
@option.cache
@click.option("--scenes", type=click.IntRange(min=1), default=12, show_default=True, help="Of each rig.")
@click.option(
    "--seed",
    type=click.IntRange(min=0),
    default=RigOptions.seed,
    show_default=True,
    help=f"Of the scenes; nothing is ever adjusted with {RIG_SEED}, which is for judging.",
)
@click.option("--only", multiple=True, metavar="RIG", type=click.Choice(list(CASES)), help="May be repeated.")
def rigs(output: Path, workers: int, cache: Path, scenes: int, seed: int, only: Sequence[str]) -> None:
    """Other cameras, distances, boxes and worlds than the platform's."""
    results = _begun(output, quick=False)
    options = RigOptions(scenes, seed, tuple(only) or tuple(CASES), workers, cache)
    results["rigs"] = measure_rigs(options, lambda line: click.echo(line, err=True))
    _finish(results, output)


@click.command()
@option.quick
@option.output
@option.workers
@option.cache
@option.seed(MOTION_SEED, "films")
def motion(quick: bool, output: Path, workers: int, cache: Path, seed: int) -> None:
    """Fast motions: cameras grabbed one after another, and the pose a moment ahead."""
    results = _begun(output, quick)
    _add_motion(results, _motion_options(quick, workers, cache, seed))
    _finish(results, output)


@click.command(name="all")
@option.quick
@option.real
@option.output
@option.scene_options
@click.option("--publish", is_flag=True, help="Write benchmarks/results.md as well.")
def everything(quick: bool, real: Path, output: Path, publish: bool, **chosen: Any) -> None:
    """Accuracy, speed, films, fast motions, dice and report."""
    results = _begun(output, quick)
    # Before the caches are hot and the disk busy with pictures.
    _add_speed(results, quick, real)
    options = _options(quick, **chosen)
    _add_accuracy(results, output, options, real)
    _add_films(results, output, _film_options(quick, options.workers, options.cache))
    _add_motion(results, _motion_options(quick, options.workers, options.cache))
    _add_dice(results, output, _dice_options(quick, options.workers, options.cache), real)
    _finish(results, output)
    click.echo(f"{write_report(output)}", err=True)
    if publish:
        write_whole(PUBLISHED, results_markdown(read_results(output)))


@click.command()
@option.output
def report(output: Path) -> None:
    """Write report.html from the results of a folder."""
    click.echo(write_report(output))


@click.command()
@option.output
@click.option(
    "--baseline",
    type=click.Path(dir_okay=False, path_type=Path),
    default=gates.BASELINE,
    show_default="benchmarks/judge/baseline.json",
    help="What the results are compared with.",
)
@click.option("--update", is_flag=True, help="Make these results the baseline.")
def gate(output: Path, baseline: Path, update: bool) -> None:
    """Fail where a figure has fallen by more than its tolerance since the baseline."""
    results = read_results(output)
    if update:
        gates.write_baseline(results, baseline)
        return
    worse, absent = gates.failures(gates.read_baseline(baseline), results)
    for line in absent:
        click.echo(f"not compared: {line}", err=True)
    for line in worse:
        click.echo(f"worse: {line}")
    if worse:
        sys.exit(1)
    click.echo("nothing has fallen by more than its tolerance")


def _options(
    quick: bool, only: Sequence[str], objects: Sequence[str], workers: int, cache: Path
) -> AccuracyOptions:
    workloads: Sequence[Workload] = [BY_NAME[name] for name in only] or WORKLOADS
    if quick and not only:
        workloads = without_package(workloads)
    return AccuracyOptions(
        QUICK if quick else FULL, tuple(workloads), tuple(objects) or OBJECTS, workers, cache
    )


def _dice_options(quick: bool, workers: int, cache: Path, seed: int = DICE_SEED) -> DiceOptions:
    options = QUICK_DICE if quick else DiceOptions()
    return dataclasses.replace(options, seed=seed, workers=workers, cache=cache)


def _film_options(quick: bool, workers: int, cache: Path, seed: int = FILM_SEED) -> FilmOptions:
    options = QUICK_FILMS if quick else FilmOptions()
    return dataclasses.replace(options, seed=seed, workers=workers, cache=cache)


def _motion_options(quick: bool, workers: int, cache: Path, seed: int = MOTION_SEED) -> MotionOptions:
    options = QUICK_MOTION if quick else MotionOptions()
    return dataclasses.replace(options, seed=seed, workers=workers, cache=cache)


def _begun(output: Path, quick: bool) -> Results:
    """Results of the folder that this run adds to: of the same commit and kind, else new ones."""
    about = {"commit": _commit(), "processor": _processor(), "seed": SEED, "quick": quick}
    try:
        found = read_results(output)
    except ResultsError:
        return {"about": about, "frames": []}
    same = all(found.get("about", {}).get(key) == value for key, value in about.items())
    return found if same else {"about": about, "frames": []}


def _add_accuracy(results: Results, output: Path, options: AccuracyOptions, real: Path) -> None:
    run = measure_accuracy(options, lambda line: click.echo(line, err=True))
    results["about"] |= {"scenes": dataclasses.asdict(options.sizes), "skipped": run.skipped}
    for name, why in run.skipped.items():
        click.echo(f"left out: {name}: {why}", err=True)
    results["frames"] = [dataclasses.asdict(record) for record in run.records]
    results["summary"] = run.summary()
    output.mkdir(parents=True, exist_ok=True)
    results["worst"] = worst_pictures(
        select(run.records, "realistic"), lambda record: _shown(run, record), output
    )
    if Path(real).is_dir():
        click.echo("recorded images", err=True)
        results["recorded"] = {"triplets": pose_rows(Path(real), DRAWS[results["about"]["quick"]])}
        results["segmentation"] = {"objects": segmentation_rows(Path(real))}


def _shown(run: AccuracyRun, record: FrameRecord) -> Shown:
    given, answer = again(run, record)
    pose, scene = answer.object_pose, given.scene
    return Shown(
        given.images,
        given.true_rig,
        tracker.load_object(record.object),
        None if pose is None else (pose.position, pose.rotation),
        None if scene.position is None or scene.rotation is None else (scene.position, scene.rotation),
    )


def _add_speed(results: Results, quick: bool, real: Path) -> None:
    click.echo("speed", err=True)
    results["speed"] = measure_speed(real if Path(real).is_dir() else None, QUICK_SPEED if quick else None)


def _add_dice(results: Results, output: Path, options: DiceOptions, real: Path) -> None:
    results["dice"], judged = measure_dice(
        options, real if Path(real).is_dir() else None, lambda line: click.echo(line, err=True)
    )
    output.mkdir(parents=True, exist_ok=True)
    click.echo(write_worst_dice(judged, options, output), err=True)


def _add_films(results: Results, output: Path, options: FilmOptions) -> None:
    results["films"], shown = measure_films(options, lambda line: click.echo(line, err=True))
    output.mkdir(parents=True, exist_ok=True)
    click.echo(write_film_plot(shown, output), err=True)


def _add_motion(results: Results, options: MotionOptions) -> None:
    results["motion"] = measure_motion(options, lambda line: click.echo(line, err=True))


def _finish(results: Results, output: Path) -> None:
    results["targets"] = evaluate(records_of(results), results.get("speed"))
    results["targets"] += film_targets(results.get("films", {}).get("figures", {}))
    results["targets"] += dice_targets(results.get("dice", {}).get("figures", {}))
    output.mkdir(parents=True, exist_ok=True)
    write_results(output / RESULTS_FILE, results)
    click.echo(results_markdown(read_results(output)))


def _processor() -> str:
    lines = Path("/proc/cpuinfo").read_text().splitlines() if Path("/proc/cpuinfo").exists() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor()


def _commit() -> str:
    done = subprocess.run(
        ["git", "describe", "--always", "--dirty"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    return done.stdout.strip() or "unknown"
