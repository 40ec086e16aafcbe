"""`tracker view`: a recording and its poses in time and space."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import click

from tracker.cli.options import (
    Cameras,
    calibration_options,
    colors_option,
    object_option,
    part_options,
    quiet_option,
    recover_option,
    rig_of,
)
from tracker.cli.outputs import Command, OutFile, Recording
from tracker.cli.render import bar
from tracker.cli.track_outputs import observation
from tracker.errors import LogError

if TYPE_CHECKING:
    from tracker.calibration.by_object.health import Sample
    from tracker.calibration.rig import CameraRig
    from tracker.conventions import Image
    from tracker.logs import Log
    from tracker.objects.model import CuboidModel
    from tracker.pipeline import ObjectTracker
    from tracker.pose.result import Observation
    from tracker.poses.poses import Poses
    from tracker.segmentation.color_model import ColorModel

_STAMP_TOLERANCE = 1e-6
"""Largest difference [s] between the stamps of a frame in a recording and in its file of poses."""


@dataclass(frozen=True)
class _Chosen:
    """Which frames to show."""

    first: int
    last: int | None
    """The first one not wanted any more; None: all are."""
    every: int

    def refuse_none(self, path: Path, count: int) -> None:
        """Refuse a beginning beyond the end."""
        if self.first and self.first >= count:
            raise LogError(f"{path}: found {count} frames, expected --from {self.first} below")

    def __contains__(self, index: int) -> bool:
        in_range = index >= self.first and (self.last is None or index < self.last)
        return in_range and (index - self.first) % self.every == 0


_Frames = Iterator[tuple[int, float, "Observation", Sequence["Image | None"], "Sample | None"]]
"""What `Scene.show` takes of each frame."""


@click.command(cls=Command, short_help="Show a recording in time and space.")
@click.argument("source", metavar="LOG|POSES", type=Recording())
@click.option("--log", metavar="LOG", type=Recording(), help="The recording of the POSES, for its images.")
@object_option("that of the POSES")
@calibration_options
@click.option(
    "-o",
    "--output",
    metavar="FILE",
    type=OutFile(".rrd"),
    help="Write a file for the viewer (.rrd).  [default: open the viewer; without a screen, a file here]",
)
@colors_option()
@recover_option
@part_options
@click.option(
    "--every", metavar="N", type=click.IntRange(1), default=1, help="Show each Nth frame.  [default: 1]"
)
@quiet_option("No progress bar, and nothing about the file.")
def view(
    source: Path,
    log: Path | None,
    object_name: str | None,
    cameras: Cameras,
    output: Path | None,
    colors_name: str | None,
    recover: bool,
    first: int,
    last: int | None,
    every: int,
    quiet: bool,
) -> None:
    """Show a recording in time and space: cameras, images, poses, uncertainty, status, and how the rig fares.

    POSES is a file that `tracker track` wrote; with --log the images of its recording are shown, too. A LOG
    alone is tracked on the way, which needs --object.

    The viewer is Rerun: python3 -m pip install '.[rerun]'. `rerun FILE.rrd` opens a file.
    """
    from tracker.logs import open_log
    from tracker.logs.cameras import fitted_to
    from tracker.poses.file import is_poses_file, read_poses
    from tracker.viz.rerun_viewer import require_rerun

    require_rerun()
    target = _target(source, output)
    chosen = _Chosen(first, last, every)
    if is_poses_file(source):
        if any(cameras):
            raise click.UsageError(f"{source}: the calibration is in this file of poses, expected no other")
        if colors_name is not None:
            raise click.UsageError(f"--colors {colors_name}: {source} holds poses, nothing is tracked")
        poses = read_poses(source)
        model = _model_of(poses, object_name)
        chosen.refuse_none(source, int(poses.index[-1]) + 1 if len(poses) else 0)
        rows = [row for row, index in enumerate(poses.index.tolist()) if index in chosen]
        if log is None:
            _show(source, target, poses.about.rig, model, _from_poses(poses, rows), len(rows), quiet)
            return
        with open_log(log, recover=recover) as opened:
            rig = fitted_to(log, opened, poses.about.rig)
            frames = _with_images(log, opened, rig, model, poses, rows, every)
            _show(source, target, rig, model, frames, len(rows), quiet)
        return
    if log is not None:
        raise click.UsageError(f"--log {log}: {source} is no file of poses, whose recording that could be")
    with open_log(source, recover=recover) as opened:
        if object_name is None:
            raise click.UsageError(f"{source}: expected --object, to track this recording")
        from tracker.objects.model import load_object
        from tracker.segmentation.color_model import load_colors

        model = load_object(object_name)
        colors = load_colors(colors_name or model.colors)
        rig = rig_of(source, opened, cameras)
        chosen.refuse_none(source, len(opened))
        part = range(len(opened))[first:last]
        _show(
            source,
            target,
            rig,
            model,
            _tracked(opened, rig, model, colors, chosen),
            len(part[::every]),
            quiet,
        )


def _show(
    source: Path,
    target: Path | None,
    rig: CameraRig,
    model: CuboidModel,
    frames: _Frames,
    count: int,
    quiet: bool,
) -> None:
    from tracker.viz.rerun_viewer import open_scene

    with open_scene(target, rig, model) as scene, bar(source.name, count, quiet) as progress:
        for frame in frames:
            scene.show(*frame)
            progress(1)
    if target is not None and not quiet:
        click.echo(f"wrote {target}; rerun {target} shows it")


def _target(source: Path, output: Path | None) -> Path | None:
    """The file to write; None: a viewer is to be opened."""
    if output is not None:
        return output
    if sys.platform in ("win32", "darwin") or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
        return None
    target = Path(f"{source.resolve().stem}.rrd")
    if target.exists():
        raise click.UsageError(f"found no screen, and {target} already; expected -o FILE")
    return target


def _model_of(poses: Poses, object_name: str | None) -> CuboidModel:
    from tracker.objects.model import load_object

    model = load_object(object_name or poses.about.object_name)
    if model.name != poses.about.object_name:
        raise click.UsageError(
            f"--object: found {model.name}, expected {poses.about.object_name}, whose poses these are"
        )
    return model


def _from_poses(poses: Poses, rows: Sequence[int]) -> _Frames:
    for row in rows:
        yield int(poses.index[row]), float(poses.timestamp[row]), observation(poses, row), (), None


def _with_images(
    path: Path,
    log: Log,
    rig: CameraRig,
    model: CuboidModel,
    poses: Poses,
    rows: Sequence[int],
    every: int,
) -> _Frames:
    """The poses with the images of their frames; LogError where the recording is another."""
    if not rows:
        return
    from tracker.pipeline import ObjectTracker

    tracker = ObjectTracker(model, rig)
    row_of = {int(poses.index[row]): row for row in rows}
    first, last = min(row_of), max(row_of)
    if last >= len(log):
        raise LogError(f"{path}: found {len(log)} frames, expected frame {last}, of which there is a pose")
    for frame in log[first : last + 1 : every]:
        row = row_of.get(frame.index)
        if row is None:
            continue
        stamp = float(poses.timestamp[row])
        if abs(frame.timestamp - stamp) > _STAMP_TOLERANCE:
            raise LogError(
                f"{path}: frame {frame.index}: found the stamp {frame.timestamp:.6f} s, expected "
                f"{stamp:.6f} s: the poses are those of another recording"
            )
        answer = observation(poses, row)
        yield frame.index, stamp, answer, frame.images, _health(tracker, frame.images, answer)


def _tracked(log: Log, rig: CameraRig, model: CuboidModel, colors: ColorModel, chosen: _Chosen) -> _Frames:
    """The frames of a recording, tracked; also those that are not shown."""
    from tracker.pipeline import ObjectTracker

    tracker = ObjectTracker(model, rig, colors)
    starts = frozenset(log.episode_starts)
    for frame in log[chosen.first : chosen.last]:
        if frame.index in starts:
            tracker.reset()
        answer = tracker.update(frame.images, frame.timestamp)
        if frame.index in chosen:
            yield frame.index, frame.timestamp, answer, frame.images, _health(tracker, frame.images, answer)


def _health(tracker: ObjectTracker, images: Sequence[Image | None], answer: Observation) -> Sample:
    """What a frame tells of the rig."""
    from tracker.calibration.by_object.health import sample, slow

    motion = answer.filtered_object_pose
    return sample(tracker, images, still=motion is not None and slow(motion.velocity))
