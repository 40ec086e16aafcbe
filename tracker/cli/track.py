"""`tracker track`: the object's pose in every frame of a recording."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tracker.cli.calibration import Cameras, calibration_options
from tracker.cli.names import colors_option, object_option
from tracker.cli.part import part_options, refuse_no_part
from tracker.cli.progress import bar
from tracker.cli.protect import check_suffix, refuse_file, refuse_other_content, refuse_overwriting
from tracker.cli.table import listing
from tracker.cli.track_outputs import Outputs, write_film, write_health_page
from tracker.errors import TrackerError, reason

if TYPE_CHECKING:
    from tracker.recordings import Options, Recipe

_FILE = click.Path(path_type=Path)

CONTRADICTED = 0.02
"""Share of the frames with a pose that cameras contradict, from which the calibration is named."""


@click.command()
@click.argument("logs", nargs=-1, required=True, metavar="LOG...", type=_FILE)
@object_option()
@click.option(
    "-o", "--output", required=True, metavar="FILE", type=_FILE, help="File of poses (.h5), or a folder."
)
@calibration_options
@colors_option()
@part_options
@click.option("--csv", metavar="FILE", type=_FILE, help="Write the poses as a table, too.")
@click.option("--tum", metavar="FILE", type=_FILE, help="Write them as a trajectory in the TUM format.")
@click.option("--bop", metavar="FILE", type=_FILE, help="Write them as BOP results of the --camera.")
@click.option("--camera", metavar="NAME", help="Camera of the BOP results, e.g. camera60.")
@click.option("--video", metavar="FILE", type=_FILE, help="Film the frames with the pose drawn in (.mp4).")
@click.option("--plot", metavar="FILE", type=_FILE, help="Plot the poses over time (.png).")
@click.option(
    "--health", metavar="FILE", type=_FILE, help="Write a page on cameras, light and calibration (.html)."
)
@click.option(
    "--jobs",
    metavar="N",
    type=click.IntRange(1),
    default=1,
    help="Processes that share the LOGs.  [default: 1]",
)
@click.option("--recover", is_flag=True, help="Leave out what is damaged of a recording.")
@click.option("--json", "as_json", is_flag=True, help="Print the summary as one JSON object a recording.")
@click.option("-q", "--quiet", is_flag=True, help="No progress bar, and no summary unless with --json.")
def track(
    logs: tuple[Path, ...],
    object_name: str,
    output: Path,
    cameras: Cameras,
    colors_name: str | None,
    first: int,
    last: int | None,
    csv: Path | None,
    tum: Path | None,
    bop: Path | None,
    camera: str | None,
    video: Path | None,
    plot: Path | None,
    health: Path | None,
    jobs: int,
    recover: bool,
    as_json: bool,
    quiet: bool,
) -> None:
    """Find an object's pose in every frame of a recording.

    LOG is a camera log of the platform (.dat, .h5), a job's folder, or a folder of images. The
    calibration is the one in or beside it, unless --calibration names another. Of several LOGs each gets
    a file of poses in the folder that -o names, under its own path; --jobs share them.

    What is there already, whole and of the same recording, object, calibration and code, is not tracked
    again. docs/poses.md describes the files.
    """
    from tracker.recordings import Options, Recipe
    from tracker.recordings.many.results import outputs_of

    refuse_no_part(first, last)
    cameras.refuse_pattern_alone()
    outputs = Outputs(csv, tum, bop, camera, video, plot, health)
    if len(logs) > 1 and outputs.files:
        raise click.UsageError(f"{', '.join(outputs.files)}: expected one LOG, found {len(logs)}")
    inside = len(logs) > 1 or output.is_dir()
    if inside:
        refuse_file("-o", output)
    targets = outputs_of(logs, output) if inside else [output]
    files = {f"-o for {log}": path for log, path in zip(logs, targets, strict=True)}
    if len(logs) == 1:
        files = {"-o": targets[0], **outputs.files}
    others = (object_name, colors_name, *cameras.calibration)
    refuse_overwriting(files, logs, others, new_folders=inside)
    outputs.check()
    for target in targets:
        check_suffix("-o", target, ".h5", ".hdf5")
        refuse_other_content("-o", target)
    options = Options(
        *(object_name, colors_name, *cameras),
        *(first, last, recover),
    )
    if len(logs) == 1:
        _track_one(logs[0], targets[0], Recipe.of(options), outputs, as_json, quiet)
        return
    output.mkdir(exist_ok=True)
    _track_all(logs, targets, options, jobs, as_json, quiet)


def _track_one(log: Path, target: Path, recipe: Recipe, outputs: Outputs, as_json: bool, quiet: bool) -> None:
    from tracker.logs import open_log
    from tracker.recordings import Job, run
    from tracker.recordings.many.work import described
    from tracker.recordings.track import chosen, rig_for

    job = Job(log, target, recipe)
    with open_log(log, recover=recipe.recover) as opened:
        outputs.check_camera(rig_for(job, opened))
        first, last = chosen(opened, job)
    target.parent.mkdir(parents=True, exist_ok=True)
    with bar(log.name, last - first, quiet) as progress:
        tracked = run(job, progress)
    result = described(job, tracked)
    _warn(result)
    outputs.write(tracked.poses)
    if outputs.video is not None:
        count = len(tracked.poses)
        with open_log(log, recover=recipe.recover) as opened, bar("film", count, quiet) as progress:
            write_film(outputs.video, opened, recipe.model, tracked.poses, progress)
    if outputs.health is not None:
        count = min(len(tracked.poses), 200)
        with open_log(log, recover=recipe.recover) as opened, bar("health", count, quiet) as progress:
            result["health"] = write_health_page(outputs.health, opened, recipe, tracked.poses, progress)
    _print(result, as_json, quiet)


def _track_all(
    logs: Sequence[Path], targets: Sequence[Path], options: Options, jobs: int, as_json: bool, quiet: bool
) -> None:
    """Track recordings side by side; what is said of them is in their order."""
    from tracker.recordings import Recipe
    from tracker.recordings.many.engine import engine
    from tracker.recordings.many.work import Task, agreed, track_task

    recipe = Recipe.of(options)
    mark = agreed(recipe)
    tasks = [Task(str(log), str(path), options, mark) for log, path in zip(logs, targets, strict=True)]
    number = {task.output: k for k, task in enumerate(tasks)}
    results: dict[int, dict[str, Any] | Exception] = {}
    failed, told = False, 0
    with engine(min(jobs, len(tasks))) as workers, bar("recordings", len(tasks), quiet, "recordings") as done:
        for task, result in workers.each(track_task, tasks):
            results[number[task.output]] = result
            done(1)
            while told in results:
                # Of those that failed the others may well be whole; the exit code tells.
                failed |= not _tell(results.pop(told), as_json, quiet)
                told += 1
    if failed:
        click.get_current_context().exit(2)


def _tell(result: dict[str, Any] | Exception, as_json: bool, quiet: bool) -> bool:
    """Say what came of a recording; whether that is well."""
    if isinstance(result, Exception):
        if not isinstance(result, (TrackerError, OSError)):
            raise result
        _say(reason(result))
        return False
    _warn(result)
    _print(result, as_json, quiet)
    return True


def _warn(result: dict[str, Any]) -> None:
    """Say what is wrong with a recording of which some is tracked."""
    if result["fault"] is not None:
        ending = f", the last one is {result['last_frame']}" if result["frames"] else ""
        _say(f"warning: {result['fault']}; tracked {result['frames']} of {result['expected']} frames{ending}")
    if result["swapped"] is not None:
        _say(f"warning: {result['log']}: {result['swapped']}")


def _print(result: dict[str, Any], as_json: bool, quiet: bool) -> None:
    if as_json:
        click.echo(json.dumps(result, allow_nan=False))
    elif not quiet:
        click.echo(_text(result))


def _say(message: str) -> None:
    click.echo(f"tracker: {' '.join(message.split())}", err=True)


def _camera_rows(cameras: dict[str, dict[str, float | None]] | None) -> list[list[str]]:
    """What is to be said of cameras that were not used for long, and where to look."""
    from tracker.pose.result import CameraUse
    from tracker.recordings.outcome.summary import to_look_at

    said = {
        CameraUse.CONTRADICTING: (
            "contradicts the others in {:.1%} of the frames with a measured pose:",
            "was it moved after its calibration, is it mirrored or late, or in another one's place?",
        ),
        CameraUse.NO_IMAGE: ("gave no image in {:.1%} of the frames:", "is it connected, is the log whole?"),
        CameraUse.FROZEN: ("repeated an old image in {:.1%} of the frames:", "did it or its driver stop?"),
        CameraUse.BLACK: ("gave a black image in {:.1%} of the frames:", "is it covered, is there light?"),
    }
    rows = []
    for name, shares in to_look_at(cameras or {}).items():
        for number, (use, share) in enumerate(shares.items()):
            found, look = said[use]
            rows += [["" if number else name, found.format(share)], ["", f"  {look}"]]
    return rows


def _calibration_rows(statuses: dict[str, dict[str, float]]) -> list[list[str]]:
    """What is to be said of a calibration that the cameras contradict."""
    from tracker.pose.result import Status

    numbers = statuses.get(Status.INCONSISTENT_VIEWS.value, {"share": 0.0, "with_pose": 0.0})
    share = numbers["share"] * numbers["with_pose"]
    if share < CONTRADICTED:
        return []
    return [
        [
            "calibration",
            f"in {share:.1%} of the frames cameras contradict each other lastingly: it does not fit;",
        ],
        ["", "  is it that of these cameras? tracker calibrate check says which one moved"],
    ]


def _text(result: dict[str, Any]) -> str:
    rows = [["log", result["log"]], ["poses", result["output"]], ["frames", str(result["frames"])]]
    if result["frames"]:
        rows.append(["with a pose", f"measured {result['measured']:.1%}, filtered {result['filtered']:.1%}"])
        for name, numbers in sorted(result["statuses"].items(), key=lambda item: -item[1]["share"]):
            share = f"{numbers['share']:.1%} of the frames"
            rows.append([f"  {name}", f"{share}, of which {numbers['with_pose']:.1%} have a pose"])
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
        rows.append(["speed", f"{result['frames_per_second']:.0f} triplets/s"])
    return listing(rows)
