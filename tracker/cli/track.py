"""`tracker track`: the object's pose in every frame of a recording."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tracker.cli.calibration import optional_calibration_options, rig_of
from tracker.cli.progress import bar
from tracker.cli.table import listing
from tracker.cli.track_outputs import Outputs, refuse_overwriting, write_film
from tracker.errors import TrackerError

if TYPE_CHECKING:
    from tracker.calibration.rig import CameraRig
    from tracker.recordings import Job, Workers

_FILE = click.Path(path_type=Path)


@click.command()
@click.argument("logs", nargs=-1, required=True, metavar="LOG...", type=_FILE)
@click.option("--object", "object_name", required=True, metavar="NAME", help="Object, or its TOML file.")
@click.option(
    "-o", "--output", required=True, metavar="FILE", type=_FILE, help="File of poses (.h5), or a folder."
)
@optional_calibration_options
@click.option(
    "--colors", "colors_name", metavar="NAME", help="Colour model, or its file.  [default: the object's]"
)
@click.option("--from", "first", metavar="N", type=click.IntRange(0), default=0, help="First frame wanted.")
@click.option("--to", "last", metavar="N", type=click.IntRange(1), help="First frame not wanted any more.")
@click.option("--csv", metavar="FILE", type=_FILE, help="Write the poses as a table, too.")
@click.option("--tum", metavar="FILE", type=_FILE, help="Write them as a trajectory in the TUM format.")
@click.option("--bop", metavar="FILE", type=_FILE, help="Write them as BOP results of the --camera.")
@click.option("--camera", metavar="NAME", help="Camera of the BOP results, e.g. camera60.")
@click.option("--video", metavar="FILE", type=_FILE, help="Film the frames with the pose drawn in (.mp4).")
@click.option("--plot", metavar="FILE", type=_FILE, help="Plot the poses over time (.png).")
@click.option(
    "--jobs",
    metavar="N",
    type=click.IntRange(1),
    default=1,
    help="Processes that share the work.  [default: 1]",
)
@click.option("--recover", is_flag=True, help="Leave out what is damaged of a recording.")
@click.option("--json", "as_json", is_flag=True, help="Print the summary as one JSON object a recording.")
@click.option("-q", "--quiet", is_flag=True, help="No progress bar, and no summary unless with --json.")
def track(
    logs: tuple[Path, ...],
    object_name: str,
    output: Path,
    calibration: tuple[str, ...],
    pattern: str | None,
    correct_halved_principal_point: bool,
    colors_name: str | None,
    first: int,
    last: int | None,
    csv: Path | None,
    tum: Path | None,
    bop: Path | None,
    camera: str | None,
    video: Path | None,
    plot: Path | None,
    jobs: int,
    recover: bool,
    as_json: bool,
    quiet: bool,
) -> None:
    """Find an object's pose in every frame of a recording.

    LOG is a camera log of the platform (.dat, .h5), a job's folder, or a folder of images. The
    calibration is the one in or beside it, unless --calibration names another. Of several LOGs each gets
    a file of poses in the folder that -o names.

    A run that was broken off goes on where it was when the same command is given again. Whatever --jobs
    is, the poses are the same. docs/poses.md describes the files.
    """
    from tracker.objects.model import load_object
    from tracker.recordings import Job, Workers
    from tracker.segmentation.color_model import load_colors

    if last is not None and last <= first:
        raise click.UsageError(f"--from {first} --to {last}: expected --to beyond --from")
    outputs = Outputs(csv, tum, bop, camera, video, plot)
    outputs.check()
    if len(logs) > 1 and outputs.files:
        raise click.UsageError(f"{', '.join(outputs.files)}: expected one LOG, found {len(logs)}")
    targets = _targets(logs, output)
    files = {"-o": targets[0], **outputs.files} if len(logs) == 1 else {}
    refuse_overwriting(
        files or {f"-o for {log}": path for log, path in zip(logs, targets, strict=True)}, logs
    )
    model = load_object(object_name)
    colors = load_colors(colors_name or model.colors)
    cameras = (calibration, pattern, correct_halved_principal_point)
    failed = False
    with Workers(jobs) as workers:
        for log, target in zip(logs, targets, strict=True):
            try:
                rig, frames = _look(log, recover, cameras)
                outputs.check_camera(rig)
                job = Job(log, target, model, rig, colors, first, last, recover)
                _track_one(job, outputs, workers, frames, as_json, quiet)
            except (TrackerError, OSError) as error:
                if len(logs) == 1:
                    raise
                # The others may well be whole; the exit code tells.
                failed = True
                _say(str(error))
    if failed:
        click.get_current_context().exit(2)


def _track_one(job: Job, outputs: Outputs, workers: Workers, frames: int, as_json: bool, quiet: bool) -> None:
    from tracker.logs import open_log
    from tracker.recordings import track as track_recording
    from tracker.recordings.summary import summary

    label = job.about.source
    with bar(label, frames if job.last is None else min(frames, job.last) - job.first, quiet) as progress:
        tracked = track_recording(job, workers, progress)
    poses = tracked.poses
    if tracked.fault is not None:
        ending = f", the last one is {poses.index[-1]}" if len(poses) else ""
        _say(f"warning: {tracked.fault}; tracked {len(poses)} of {tracked.expected} frames{ending}")
    outputs.write(poses)
    if outputs.video is not None:
        with open_log(job.log, recover=job.recover) as log, bar("film", len(poses), quiet) as progress:
            write_film(outputs.video, log, job.model, poses, progress)
    result = {
        "log": str(job.log),
        "output": str(job.output),
        "object": job.model.name,
        **summary(tracked),
    }
    if as_json:
        click.echo(json.dumps(result, allow_nan=False))
    elif not quiet:
        click.echo(_text(result))


def _targets(logs: Sequence[Path], output: Path) -> list[Path]:
    """The file of poses of each recording; of several, they are named after what tells them apart."""
    if len(logs) == 1:
        return [output / _name(logs[0].resolve().parts[-1:]) if output.is_dir() else output]
    output.mkdir(exist_ok=True)
    paths = [log.resolve().parts for log in logs]
    common = 0
    while all(len(parts) > common + 1 and parts[common] == paths[0][common] for parts in paths):
        common += 1
    targets = [output / _name(parts[common:]) for parts in paths]
    for number, target in enumerate(targets):
        if target in targets[:number]:
            raise click.UsageError(f"{logs[number]}: found a LOG of the same name, expected different ones")
    return targets


def _name(parts: Sequence[str]) -> str:
    stem = Path(parts[-1]).name
    for suffix in (".gz", ".dat", ".h5", ".hdf5", ".zarr"):
        stem = stem.removesuffix(suffix)
    return "_".join([*parts[:-1], stem]) + ".poses.h5"


def _look(
    path: Path, recover: bool, cameras: tuple[tuple[str, ...], str | None, bool]
) -> tuple[CameraRig, int]:
    """The calibration to be used, and the number of frames that the recording states."""
    from tracker.logs import open_log

    with open_log(path, recover=recover) as log:
        return rig_of(path, log, *cameras), len(log)


def _say(message: str) -> None:
    click.echo(f"tracker: {' '.join(message.split())}", err=True)


def _camera_rows(cameras: dict[str, dict[str, float | None]] | None) -> list[list[str]]:
    """What is to be said of cameras that were not used for long, and where to look."""
    from tracker.pose.result import CameraUse
    from tracker.recordings.summary import to_look_at

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


def _text(result: dict[str, Any]) -> str:
    rows = [["log", result["log"]], ["poses", result["output"]], ["frames", str(result["frames"])]]
    if result["frames"]:
        rows.append(["with a pose", f"measured {result['measured']:.1%}, filtered {result['filtered']:.1%}"])
        for name, numbers in sorted(result["statuses"].items(), key=lambda item: -item[1]["share"]):
            share = f"{numbers['share']:.1%} of the frames"
            rows.append([f"  {name}", f"{share}, of which {numbers['with_pose']:.1%} have a pose"])
    for label, key in (("std x y z [mm]", "position_std_median_mm"), ("  [deg]", "rotation_std_median_deg")):
        if result[key] is not None:
            values = "  ".join(f"{value:.3f}" for value in result[key])
            rows.append([label, f"{values}  (median of the {result['kind']} poses)"])
    recorded = result["recorded"]
    if recorded is not None and recorded["position_median_mm"] is not None:
        for label, key, unit in (("to the recorded", "position", "mm"), ("", "angle", "deg")):
            median, p90 = recorded[f"{key}_median_{unit}"], recorded[f"{key}_p90_{unit}"]
            rows.append([label, f"median {median:.2f} {unit}, 90th percentile {p90:.2f} {unit}"])
    rows += _camera_rows(result["cameras"])
    if result["frames_per_second"] is not None:
        rows.append(["speed", f"{result['frames_per_second']:.0f} triplets/s"])
    return listing(rows)
