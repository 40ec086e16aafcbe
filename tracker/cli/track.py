"""`tracker track`: find the object's pose in every frame of a recording."""

import json
from collections import deque
from collections.abc import Sequence
from dataclasses import astuple
from pathlib import Path
from typing import Any

import click

import tracker
from tracker.batch.results import outputs_of
from tracker.batch.run import Task, described, track_task
from tracker.batch.workers import engine
from tracker.calibration.by_object.health import MOST
from tracker.calibration.by_object.health import health as measured_health
from tracker.cli import options
from tracker.cli.export import Outputs, write_tracked_film
from tracker.cli.options import command, file_option, flag, option, several
from tracker.cli.outputs import AnyPath, OutFile, OutFolder, Recording, refuse_overwriting
from tracker.cli.terminal import bar, listing, say
from tracker.errors import TrackerError, reason
from tracker.files import write_whole
from tracker.poses.file import refuse_other_file, refuse_other_object
from tracker.recordings import Job
from tracker.recordings.track import chosen, rig_for, run
from tracker.summaries.summary import to_look_at
from tracker.viz.calibration import page

CONTRADICTED = 0.02
"""Share of frames with a pose that cameras contradict at which the calibration is reported."""


@command()
def track(
    *,
    logs: tuple[Path, ...] = several("RECORDING", Recording()),
    output: Path = option(
        "FILE|DIR", "File of poses (.h5), or a folder that exists.", AnyPath(), required=True
    ),
    overwrite: bool = flag("Replace poses of another object."),
    asked: options.Asked,
    outputs: Outputs,
    health: Path | None = file_option(
        "A page on cameras, light and calibration (.html).", ".html", extra="plot"
    ),
    jobs: int = options.whole("Processes that share the RECORDINGs.", default=1),
    as_json: bool = flag("Print the summary as one JSON object per recording.", name="--json"),
    quiet: bool = flag("No progress bar, and no summary unless with --json."),
) -> None:
    """Find an object's pose in every frame of a recording.

    RECORDING is a platform recording (.dat, .h5), a job's folder, or a folder of images or films. Its
    calibration is the one in it or beside it, unless --calibration names another. If you give several
    RECORDINGs, each gets a file of poses under its own path in the folder of -o, which is made if missing.

    Poses of the same recording, object, calibration and code are not computed again. Poses of another object
    are not replaced without --overwrite. docs/poses.md describes the files.
    """
    if len(logs) > 1 and (outputs or health):
        raise click.UsageError(f"found {len(logs)} RECORDINGs, expected one for files other than poses")
    inside = len(logs) > 1 or output.is_dir()
    if inside:
        OutFolder().check("-o", output)
    kind = OutFile(".h5", ".hdf5", new_folders=inside)
    targets = outputs_of(logs, output) if inside else [output]
    sought = asked.options()
    recipe = tracker.recordings.Recipe.of(sought)
    for log, target in zip(logs, targets, strict=True):
        name = f"-o for {log}" if len(logs) > 1 else "-o"
        refuse_overwriting({name: target}, logs, (*astuple(asked.subject), *asked.cameras.calibration))
        kind.check("-o", target)
        refuse_other_file(target, f"-o {target}")
        if not overwrite:
            refuse_other_object(target, f"-o {target}", recipe.model.name)
    if len(logs) == 1:
        _track_one(tracker.recordings.Job(logs[0], targets[0], recipe), outputs, health, as_json, quiet)
        return
    pairs = zip(logs, targets, strict=True)
    tasks = [Task(str(log), str(target), sought, recipe.digest) for log, target in pairs]
    _track_all(tasks, jobs, as_json, quiet)


def _track_one(job: Job, outputs: Outputs, health: Path | None, as_json: bool, quiet: bool) -> None:
    log, recipe = job.log, job.recipe
    with tracker.open_log(log, recover=recipe.recover) as opened:
        outputs.check_camera(rig_for(job, opened))
        count = len(chosen(log, len(opened), recipe.start, recipe.stop))
    job.output.parent.mkdir(parents=True, exist_ok=True)
    with bar(log.name, count, quiet) as progress:
        tracked = run(job, progress)
    result = described(job, tracked)
    _warn(result)
    outputs.write(tracked.poses)
    if outputs.video is not None:
        count = len(tracked.poses)
        with tracker.open_log(log, recover=recipe.recover) as opened, bar("film", count, quiet) as progress:
            write_tracked_film(outputs.video, opened, recipe.model, tracked.poses, progress)
    if health is not None:
        count = min(len(tracked.poses), MOST)
        with tracker.open_log(log, recover=recipe.recover) as opened, bar("health", count, quiet) as progress:
            about = tracked.poses.about
            finder = tracker.ObjectTracker(recipe.model, about.rig, recipe.colors)
            found = measured_health(finder, opened, tracked.poses, progress)
        write_whole(health, page(found, " · ".join(filter(None, (about.object_name, about.source)))))
        result["health"] = [*found.complaints(), *filter(None, [found.missing()])]
    _print(result, as_json, quiet)


def _track_all(tasks: Sequence[Task], jobs: int, as_json: bool, quiet: bool) -> None:
    """Track recordings in parallel, and report on them in order."""
    waiting, failed = deque(task.output for task in tasks), False
    results: dict[str, dict[str, Any] | Exception] = {}
    with engine(min(jobs, len(tasks))) as workers, bar("recordings", len(tasks), quiet, "recordings") as done:
        for task, result in workers(track_task, tasks):
            results[task.output] = result
            done(1)
            while waiting and waiting[0] in results:
                outcome = results.pop(waiting.popleft())
                if isinstance(outcome, (TrackerError, OSError)):
                    say(reason(outcome))  # other recordings may succeed; the exit code shows the failure
                    failed = True
                elif isinstance(outcome, Exception):
                    raise outcome
                else:
                    _warn(outcome)
                    _print(outcome, as_json, quiet)
    if failed:
        raise click.exceptions.Exit(2)


def _warn(result: dict[str, Any]) -> None:
    """Warn about a damaged recording, which was only partly tracked, and of a likely mistake."""
    if result["fault"] is not None:
        ending = f", the last one is {result['last_frame']}" if result["frames"] else ""
        say(f"warning: {result['fault']}; tracked {result['frames']} of {result['expected']} frames{ending}")
    if result["warning"] is not None:
        say(f"warning: {result['log']}: {result['warning']}")


def _print(result: dict[str, Any], as_json: bool, quiet: bool) -> None:
    if as_json:
        click.echo(json.dumps(result, allow_nan=False))
    elif not quiet:
        click.echo(_text(result))


def _camera_rows(cameras: dict[str, dict[str, float | None]] | None) -> list[list[str]]:
    uses = tracker.CameraUse
    moved = "did it move after its calibration? Is it mirrored, late or swapped with another?"
    remarks = {
        uses.CONTRADICTING: ("contradicts the others in {} of the frames with a measured pose:", moved),
        uses.NO_IMAGE: ("gave no image in {} of the frames:", "is it connected? Is the recording complete?"),
        uses.FROZEN: ("repeated an old image in {} of the frames:", "did the camera or its driver stop?"),
        uses.BLACK: ("gave a black image in {} of the frames:", "is it covered? Is there light?"),
    }
    rows = []
    for name, shares in to_look_at(cameras or {}).items():
        for number, (use, share) in enumerate(shares.items()):
            found, look = remarks[use]
            rows += [["" if number else name, found.format(f"{100 * share:.1f} %")], ["", f"  {look}"]]
    return rows


def _calibration_rows(statuses: dict[str, dict[str, float]]) -> list[list[str]]:
    numbers = statuses.get(tracker.Status.INCONSISTENT_VIEWS.value, {"share": 0.0, "with_pose": 0.0})
    share = numbers["share"] * numbers["with_pose"]
    if share < CONTRADICTED:
        return []
    why = f"does not fit: cameras contradict each other in {100 * share:.1f} % of the frames."
    ask = "  does it belong to these cameras? tracker calibrate check names the one that moved"
    return [["calibration", why], ["", ask]]


def _text(result: dict[str, Any]) -> str:
    rows = [["recording", result["log"]], ["poses", result["output"]], ["frames", str(result["frames"])]]
    if frames := result["frames"]:
        counts = (f"{round(result[kind] * frames)} of {frames} {kind}" for kind in ("measured", "filtered"))
        rows.append(["with a pose", ", ".join(counts)])
        for name, numbers in sorted(result["statuses"].items(), key=lambda item: -item[1]["share"]):
            count = round(numbers["share"] * frames)
            posed = round(numbers["with_pose"] * count)
            some = f", {posed} of them with a pose" if 0 < posed < count else ""
            rows.append([f"  {name}", f"{count} of {frames} frames{some}"])
    if result["confidence_median"] is not None:
        count = round(result[result["kind"]] * frames)
        sure = f"0.9 or more in {round(result['sure'] * count)} of {count} {result['kind']} poses"
        rows.append(["confidence", f"median {result['confidence_median']:.2f}, {sure}"])
    for label, key in (("std x y z [mm]", "position_std_median_mm"), ("  [°]", "rotation_std_median_deg")):
        if result[key] is not None:
            values = "  ".join(f"{value:.3f}" for value in result[key])
            rows.append([label, f"{values}  (median of the {result['kind']} poses)"])
    recorded = result["recorded"]
    if recorded is not None and recorded["position_median_mm"] is not None:
        for label, key, unit in (("to the recorded", "position_{}_mm", " mm"), ("", "angle_{}_deg", "°")):
            median, p90 = (recorded[key.format(name)] for name in ("median", "p90"))
            rows.append([label, f"median {median:.2f}{unit}, 90th percentile {p90:.2f}{unit}"])
    rows += _camera_rows(result["cameras"]) + _calibration_rows(result["statuses"])
    rows += [["" if number else "health", line] for number, line in enumerate(result.get("health", []))]
    if result["frames_per_second"] is not None:
        rows.append(["speed", f"{result['frames_per_second']:.0f} sets of images per second"])
    return listing(rows)
