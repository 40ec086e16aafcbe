"""The commands of `python -m benchmarks`: each adds its part to the results of a folder."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import click
import pandas as pd

from benchmarks.data.fingerprint import ROOT
from benchmarks.data.sets import Plan
from benchmarks.data.workloads import WORKLOADS, Workload
from benchmarks.judge.origin import origin
from benchmarks.judge.results import RESULTS_FILE, Results, ResultsError, read_results, write_results
from benchmarks.measure.accuracy import again, measure_accuracy
from benchmarks.measure.dice import measure_dice
from benchmarks.measure.estimate import estimate, spoken
from benchmarks.measure.films import measure_films
from benchmarks.measure.motion import measure_motion
from benchmarks.measure.recorded import pose_rows, segmentation_rows
from benchmarks.measure.recorded_checks import agreement_rows
from benchmarks.measure.speed import measure_speed
from benchmarks.report.dice_worst import write_worst_dice
from benchmarks.report.film_plot import write_film_plot
from benchmarks.report.worst import Shown, worst_pictures
from benchmarks.score.summary import accuracy_rows

OUTPUT = ROOT / "build" / "benchmarks"

Rows = list[dict[str, Any]]


@dataclass
class Run:
    """What is measured, and where it goes."""

    plan: Plan
    output: Path
    real: Path | None
    """Folder of recorded data, None where it is absent."""
    workloads: Sequence[Workload] = WORKLOADS
    objects: Sequence[str] | None = None
    """None: all."""
    results: Results = field(default_factory=Results)

    def say(self, line: str) -> None:
        """Tell people what comes next."""
        click.echo(line, err=True)

    @property
    def development(self) -> bool:
        """Whether single scenes may be looked at."""
        return self.results.about.get("draw") == "development"


def accuracy(run: Run) -> Rows:
    """Errors, misses, confidence and covariance on all workloads."""
    measured = measure_accuracy(run.plan, run.say, run.workloads, run.objects)
    run.results.about.setdefault("skipped", {}).update(measured.skipped)
    for name, why in measured.skipped.items():
        run.say(f"left out: {name}: {why}")
    frames = run.results.frames = measured.frames
    run.results.worst = []
    if run.development:
        chosen = frames[frames.workload == "realistic"]
        run.results.worst = worst_pictures(chosen, lambda record: _shown(run.plan, record), run.output)
    counts = frames.groupby("workload", sort=False).size()
    words = {workload.name: workload.about for workload in run.workloads}
    about = [
        {"part": "workloads", "group": name, "about": words[str(name)], "n": int(count)}
        for name, count in counts.items()
    ]
    return about + accuracy_rows(frames)


def _shown(plan: Plan, record: pd.Series) -> Shown:
    given, model, answer = again(plan, record)
    pose, scene = answer.object_pose, given.scene
    return Shown(
        given.images,
        given.true_rig,
        model,
        None if pose is None else (pose.position, pose.rotation),
        None if scene.position is None or scene.rotation is None else (scene.position, scene.rotation),
    )


def recorded(run: Run) -> Rows:
    """Poses and segmentation of recorded pictures."""
    if run.real is None:
        run.results.about.setdefault("skipped", {})["recorded pictures"] = "there are none"
        return []
    draws = max(5, run.plan.scenes // 2)
    return pose_rows(run.real, draws) + segmentation_rows(run.real)


def agreement(run: Run) -> Rows:
    """Whether cameras and sizes of recorded pictures agree, which needs no truth."""
    if run.real is None:
        run.results.about.setdefault("skipped", {})["recorded triplets"] = "there are none"
        return []
    return agreement_rows(run.real)


def speed(run: Run) -> Rows:
    """Time by stage, cameras, resolution and faces in view; start-up and memory."""
    return measure_speed(run.plan, run.real)


def films(run: Run) -> Rows:
    """Tracking over time: accuracy, losses, single cameras, a vanishing object, and time."""
    rows, shown = measure_films(run.plan, run.say)
    if run.development:
        run.say(str(write_film_plot(shown, run.output)))
    return rows


def motion(run: Run) -> Rows:
    """Fast motions: cameras grabbed one after another, and the pose a moment ahead."""
    return measure_motion(run.plan, run.say)


def dice(run: Run) -> Rows:
    """Masks, positions and time of the dice task; the recorded picture where there is one."""
    rows, judged = measure_dice(run.plan, run.real, run.say)
    if run.development:
        run.say(str(write_worst_dice(judged, run.plan, run.output)))
    return rows


# Speed comes before the caches are hot and the disk busy with pictures.
PARTS: dict[str, Callable[[Run], Rows]] = {
    part.__name__: part for part in (speed, accuracy, recorded, agreement, films, motion, dice)
}
"""What can be measured, in order."""


def measure(run: Run, parts: Sequence[str], *, anew: bool = False) -> Results:
    """Measure parts, and put them into the results of the run's folder.

    Raises:
        ResultsError: the folder holds results of other sources or scenes, or sources changed meanwhile.
    """
    run.output.mkdir(parents=True, exist_ok=True)
    about = origin() | {"seed": run.plan.seed, "scenes": run.plan.scenes, "draw": run.results.about["draw"]}
    total = estimate(run.plan, parts, run.workloads, run.objects)
    run.say(f"about {spoken(total)} on an otherwise idle machine, for {', '.join(parts)}")
    run.results = _begun(run.output, about, anew=anew or len(parts) == len(PARTS))
    for part in parts:
        expected = estimate(run.plan, [part], run.workloads, run.objects)
        run.say(f"{part}, about {spoken(expected)} on an idle machine")
        start = time.monotonic()
        run.results.replaced(PARTS[part](run))
        seconds = round(time.monotonic() - start)
        made = {"commit": about["commit"], "clean": about["clean"], "seconds": seconds}
        made["estimated"] = round(expected)
        run.results.about.setdefault("parts", {})[part] = made
        if origin()["code"] != about["code"]:
            raise ResultsError("sources were changed while they were measured; measure again")
        write_results(run.output / RESULTS_FILE, run.results)
    return run.results


def _begun(output: Path, about: dict[str, Any], *, anew: bool) -> Results:
    """Results that this run adds to."""
    if anew or not (output / RESULTS_FILE).is_file():
        return Results(dict(about))
    found = read_results(output)
    for key in ("code", "seed", "scenes"):
        if found.about.get(key) != about[key]:
            raise ResultsError(
                f"{output}: holds results of {key} {found.about.get(key)}, found {about[key]} here: parts of "
                "different trees or scenes are not put together; choose another folder with -o, or remove it"
            )
    return found
