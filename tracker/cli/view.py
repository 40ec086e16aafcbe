"""`tracker view`: a recording and its poses in the viewer Rerun."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import astuple
from pathlib import Path
from typing import TYPE_CHECKING

import click

import tracker
from tracker.cli import options
from tracker.cli.export import observation, poses_of
from tracker.cli.outputs import Command, Recording, file_option
from tracker.cli.terminal import bar

if TYPE_CHECKING:
    from tracker.calibration.by_object.health import Sample
    from tracker.conventions import Image
    from tracker.logs import LogFrame

_Frames = Iterator[tuple[int, float, "tracker.Observation", Sequence["Image | None"], "Sample | None"]]
"""What `Scene.show` takes of each frame."""


@click.command(cls=Command, short_help="Show a recording in time and space.")
@click.argument("source", metavar="LOG|POSES", type=Recording())
@click.option("--log", metavar="LOG", type=Recording(), help="The recording of the POSES, for its images.")
@options.object_name("that of the POSES")
@options.cameras
@file_option(
    "-o",
    ".rrd",
    help="Write a file for the viewer (.rrd).  [default: open the viewer; without a screen, a file here]",
)
@options.colors()
@options.part
@options.whole("--every", "Show every Nth frame.", default=1)
@options.quiet("No progress bar, and nothing about the file.")
def view(
    source: Path,
    log: Path | None,
    object_name: str | None,
    cameras: options.Cameras,
    output: Path | None,
    colors_name: str | None,
    part: options.Part,
    every: int,
    quiet: bool,
) -> None:
    """Show a recording and its poses in the viewer Rerun.

    Shows cameras, images, poses, uncertainty, status and rig health. POSES is a file that `tracker track`
    wrote; --log adds the images of its recording. A LOG alone is tracked first, which needs --object.

    The viewer is Rerun: python3 -m pip install -e '.[rerun]'. `rerun FILE.rrd` opens a file.
    """
    from tracker.poses.file import is_poses_file
    from tracker.recordings.track import answers
    from tracker.viz.rerun_viewer import open_scene, require_rerun

    require_rerun()
    target = _target(source, output)
    with ExitStack() as stack:
        if is_poses_file(source):
            if any(astuple(cameras)):
                raise click.UsageError(f"{source}: the calibration is in this file of poses, expected none")
            if colors_name is not None:
                raise click.UsageError(f"--colors {colors_name}: {source} holds poses, nothing is tracked")
            model, rig, total, frames = _of_poses(stack, source, log, object_name, part, every)
        else:
            if log is not None:
                raise click.UsageError(f"--log {log}: {source} is no file of poses, expected those of it")
            opened = stack.enter_context(tracker.open_log(source, recover=part.recover))
            if object_name is None:
                raise click.UsageError(f"{source}: expected --object, to track this recording")
            model, colors = options.Subject(object_name, colors_name).load()
            rig = cameras.rig_of(source, opened)
            chosen = part.of(source, len(opened))[::every]
            finder, total = tracker.ObjectTracker(model, rig, colors), len(chosen)
            every_frame = answers(source, opened[part.first : part.last], finder)
            frames = _looked_at(finder, (one for one in every_frame if one[0].index in chosen))
        scene = stack.enter_context(open_scene(target, rig, model))
        progress = stack.enter_context(bar(source.name, total, quiet))
        for frame in frames:
            scene.show(*frame)
            progress(1)
    if target is not None and not quiet:
        click.echo(f"wrote {target}; rerun {target} shows it")


def _of_poses(
    stack: ExitStack, source: Path, log: Path | None, object_name: str | None, part: options.Part, every: int
) -> tuple[tracker.CuboidModel, tracker.CameraRig, int, _Frames]:
    """Object, cameras, number of frames, and these, with images of a recording that the stack closes."""
    from tracker.logs.opening import fitted_to
    from tracker.summaries.summary import refuse_others

    poses, model = poses_of(source, object_name)
    numbers = poses.index.tolist()
    chosen = part.of(source, numbers[-1] + 1 if numbers else 0)[::every]
    rows = {index: row for row, index in enumerate(numbers) if index in chosen}
    if log is None:
        stamps = poses.timestamp.tolist()
        bare = ((index, stamps[row], observation(poses, row), (), None) for index, row in rows.items())
        return model, poses.about.rig, len(rows), bare
    opened = stack.enter_context(tracker.open_log(log, recover=part.recover))
    rig = fitted_to(log, opened, poses.about.rig)
    refuse_others(source, poses, log, opened)
    frames = opened[min(rows) : max(rows) + 1 : every] if rows else ()
    answered = ((one, observation(poses, rows[one.index])) for one in frames if one.index in rows)
    return model, rig, len(rows), _looked_at(tracker.ObjectTracker(model, rig), answered)


def _looked_at(
    finder: tracker.ObjectTracker, answered: Iterable[tuple[LogFrame, tracker.Observation]]
) -> _Frames:
    """Frames with what is found, their images, and how these look."""
    from tracker.calibration.by_object.health import sample
    from tracker.calibration.by_object.sightings import slow

    for frame, answer in answered:
        motion = answer.filtered_object_pose
        look = sample(finder, frame.images, still=motion is not None and slow(motion.velocity))
        yield frame.index, frame.timestamp, answer, frame.images, look


def _target(source: Path, output: Path | None) -> Path | None:
    """The file to write; None: a viewer is to be opened."""
    if output is not None:
        return output
    if sys.platform == "darwin" or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
        return None
    target = Path(f"{source.resolve().stem}.rrd")
    if target.exists():
        raise click.UsageError(f"no screen for the viewer, and {target} exists; expected -o FILE")
    return target
