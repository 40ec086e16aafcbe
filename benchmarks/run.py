"""A run: its parts, each saved as soon as it is finished, so that an interrupted run continues."""

import json
import re
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import click
import pandas as pd

from benchmarks.data.fingerprint import ROOT
from benchmarks.data.plan import Plan
from benchmarks.data.workloads import WORKLOADS, Workload
from benchmarks.judge.results import (
    RESULTS_FILE,
    Results,
    ResultsError,
    origin,
    plain,
    read_results,
    typed,
    write_results,
)
from benchmarks.measure.accuracy import Made, measure_accuracy
from benchmarks.measure.dice import measure_dice
from benchmarks.measure.films import measure_films
from benchmarks.measure.motion import measure_motion
from benchmarks.measure.recorded import measure_agreement, measure_segmentation, measure_triplets
from benchmarks.measure.start_up import measure_start_up
from tracker.files import write_whole

OUTPUT = ROOT / "build" / "benchmarks"

KEPT = "kept"
"""Folder beside the results, for the finished sets of scenes of an unfinished part."""

Frames = dict[str, pd.DataFrame]


@dataclass
class Run:
    """What is measured, and where results go."""

    plan: Plan
    output: Path
    real: Path | None
    """Folder of recorded data; None if it is absent."""
    workloads: Sequence[Workload] = tuple(workload for workload in WORKLOADS if workload.usual)
    objects: Sequence[str] | None = None
    """Names of the objects; None: all."""
    draw: str = "development"
    films: int = 6
    """Number of films for each camera of a recorded triplet."""
    results: Results = field(default_factory=Results)
    skipped: dict[str, str] = field(default_factory=dict)
    """What the part that is being measured leaves out, with reasons."""

    @property
    def asked(self) -> dict[str, Any]:
        """What a part is asked, apart from the scenes: answers to anything else are not those of this run."""
        workloads = [workload.name for workload in self.workloads]
        objects = self.objects and list(self.objects)
        return {"workloads": workloads, "objects": objects, "films": self.films, "recorded": bool(self.real)}

    def say(self, line: str) -> None:
        """Report progress on stderr."""
        click.echo(line, err=True)

    def skip(self, what: str, why: str) -> None:
        """Report and record what is left out."""
        self.say(f"left out: {what}: {why}")
        self.skipped[what] = why


def accuracy(run: Run) -> Frames:
    """Errors, confidence, covariance and time of `detect` on all workloads."""

    def keep(name: str, make: Callable[[], Made]) -> Made:
        file = run.output / KEPT / f"{re.sub(r'[^a-z0-9]+', '_', name.lower())}.json"
        key = {key: run.results.about[key] for key in IDENTITY} | {"asked": run.asked}
        kept = _kept(file)
        if kept.get("key") == key:
            return kept["answers"], kept["skipped"]
        run.say(name)
        answers, skipped = make()
        content = {"key": key, "answers": plain(answers), "skipped": skipped}
        file.parent.mkdir(parents=True, exist_ok=True)
        write_whole(file, json.dumps(content))
        return content["answers"], skipped

    answers, skipped = measure_accuracy(run.plan, run.workloads, run.objects, keep)
    for what, why in skipped.items():
        run.skip(what, why)
    return {"accuracy": answers} if len(answers) else {}


def _kept(file: Path) -> dict[str, Any]:
    """Return the finished set of scenes in a file; empty if it is missing or holds anything else."""
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) and content.keys() == {"key", "answers", "skipped"} else {}


def recorded(run: Run) -> Frames:
    """Poses, single cameras and segmentation of recorded images."""
    if run.real is None:
        run.skip("recorded images", "there are none")
        return {}
    draws = max(5, run.plan.scenes // 4)
    found = measure_triplets(run.real, draws) | measure_agreement(run.real, run.films)
    return found | {"segmentation": measure_segmentation(run.real)}


def films(run: Run) -> Frames:
    """Tracking over time: accuracy, losses, single cameras, a vanishing object, and time."""
    return {"films": measure_films(run.plan)}


def motion(run: Run) -> Frames:
    """Fast motions: cameras grabbed one after another, and the pose a moment ahead."""
    return {"motion": measure_motion(run.plan)}


def dice(run: Run) -> Frames:
    """Masks, positions and time of the dice task; the recorded image where there is one."""
    return measure_dice(run.plan, run.real)


def start_up(run: Run) -> Frames:
    """Time and memory of fresh processes."""
    return {"start-up": pd.DataFrame(measure_start_up())}


def gate(run: Run) -> Frames:
    """Return the gate's answers: a few scenes, and the recorded triplets."""
    return accuracy(run) | ({} if run.real is None else measure_agreement(run.real, run.films))


PARTS: dict[str, Callable[[Run], Frames]] = {
    part.__name__: part for part in (accuracy, recorded, films, motion, dice, start_up)
}
"""Parts that can be measured, in order."""

IDENTITY = ("code", "seed", "scenes")
"""Keys that results must share to be combined."""


def measure(run: Run, parts: Sequence[str], *, whole: bool = False) -> Results:
    """Measure parts, and add them to the results in the run's folder.

    `parts` are keys of PARTS, or `gate`. If they form a `whole` run of their own, an interrupted run is
    continued, and results for other sources, scenes or workloads are replaced.

    Raises:
        ResultsError: the folder holds results for other sources or scenes, or something else, or sources
            have changed since.
    """
    run.output.mkdir(parents=True, exist_ok=True)
    about = origin() | {"draw": run.draw, "seed": run.plan.seed, "scenes": run.plan.scenes}
    run.results = _begun(run, about, parts, whole=whole)
    for part in parts:
        if whole and part in run.results.about.get("parts", {}):
            run.say(f"{part}: measured before")
            continue
        run.say(part)
        start, run.skipped = time.monotonic(), {}
        found = (PARTS | {"gate": gate})[part](run)
        run.results.frames |= {name: typed(frame) for name, frame in found.items()}
        if origin()["code"] != about["code"]:
            raise ResultsError("sources were changed while they were measured; measure again")
        made = {
            key: about[key] for key in ("commit", "clean", "processor", "python", "libraries", "renderer")
        }
        made |= {"seconds": round(time.monotonic() - start), "asked": run.asked, "skipped": run.skipped}
        run.results.about.setdefault("parts", {})[part] = made
        write_results(run.output / RESULTS_FILE, run.results)
        for file in filter(_kept, (run.output / KEPT).glob("*.json")):
            file.unlink()
        with suppress(OSError):  # something else is there
            (run.output / KEPT).rmdir()
    return run.results


def _begun(run: Run, about: dict[str, Any], parts: Sequence[str], *, whole: bool) -> Results:
    """Return the results to which this run adds."""
    file = run.output / RESULTS_FILE
    if not file.is_file():
        for name in sorted({path.name for path in run.output.iterdir()} - {KEPT}):
            raise ResultsError(
                f"{run.output}: found {name} and no {RESULTS_FILE}, expected a new or an empty folder, or "
                "one of results; choose another with -o"
            )
        return Results(dict(about))
    found = read_results(file)
    wrong = [key for key in IDENTITY if found.about.get(key) != about[key]]
    done = found.about.get("parts", {})
    other = any(made.get("asked") != run.asked for made in done.values())
    if whole and (wrong or other or set(parts) <= set(done)):
        return Results(dict(about))
    for key in wrong:
        raise ResultsError(
            f"{file}: holds results of {key} {found.about.get(key)}, found {about[key]} here: parts of "
            "different trees or scenes are not put together; choose another folder with -o, or remove it"
        )
    return found
