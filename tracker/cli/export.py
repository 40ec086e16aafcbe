"""`tracker export`, `convert`, `view`: write poses and recordings in other formats, or show them."""

import os
import shlex
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np

import tracker
from tracker.calibration.by_object.health import Sample, sample, surely_still
from tracker.cli import options
from tracker.cli.options import argument, command, file_option, flag, option
from tracker.cli.outputs import AnyPath, InFile, Recording, parent_of, refuse_overwriting, require_folder
from tracker.cli.terminal import bar, say
from tracker.conventions import Array, Image
from tracker.logs import LogFrame, read_robot_log
from tracker.logs.folder import write_folder
from tracker.logs.hdf5_writer import write_hdf5
from tracker.logs.opening import fitted_to
from tracker.objects.model import object_names
from tracker.poses.columns import MeasuredColumns
from tracker.poses.exports import write_bop, write_csv, write_parquet, write_tum
from tracker.poses.file import is_poses_file
from tracker.recordings.track import answers
from tracker.summaries.summary import best_kind, refuse_others
from tracker.viz.image_files import film_rate, write_log_film
from tracker.viz.rerun_viewer import open_scene, require_rerun


@dataclass(frozen=True)
class Outputs:
    """Options for files with poses in other formats; None: not requested."""

    csv: Path | None = file_option("The poses as a table, one line per frame.", ".csv")
    tum: Path | None = file_option("A trajectory in the TUM format.", ".tum", ".txt")
    bop: Path | None = file_option("BOP results of the --camera.", ".csv")
    camera: str | None = option("NAME", "Camera of the BOP results, e.g. camera60.")
    video: Path | None = file_option(
        "A film of the frames with the pose drawn in (.mp4).", ".mp4", extra="video"
    )
    plot: Path | None = file_option("A plot of the poses over time (.png).", ".png", extra="plot")

    def __bool__(self) -> bool:
        return any(vars(self).values())

    def check_camera(self, rig: tracker.CameraRig) -> None:
        """Refuse an unknown camera, a camera without --bop, or --bop without a camera."""
        if (self.bop is None) != (self.camera is None):
            raise click.UsageError("--bop and --camera belong together: BOP results are for one camera")
        if self.camera is not None and self.camera not in rig.names:
            raise click.UsageError(f"--camera: found {self.camera}, expected one of {', '.join(rig.names)}")

    def write(
        self,
        poses: tracker.Poses,
        keypoints_of: tracker.CuboidModel | None = None,
        more: dict[str, Array] | None = None,
    ) -> None:
        """Write all files except the film; the table includes `more`, and the corners of a given object."""
        kind = best_kind(poses)
        if self.csv is not None:
            write_csv(self.csv, poses, keypoints_of=keypoints_of, more=more)
        if self.tum is not None:
            write_tum(self.tum, poses, kind)
        if self.bop is not None:
            rig = poses.about.rig
            write_bop(self.bop, poses, rig[rig.names.index(self.camera or "")], kind)
        if self.plot is not None:
            tracker.viz.write_trajectory_plot(self.plot, poses)


def write_tracked_film(
    path: Path,
    log: tracker.Log,
    model: tracker.CuboidModel,
    poses: tracker.Poses,
    progress: Callable[[int], None],
    rig: tracker.CameraRig | None = None,
) -> None:
    """Write a film of the tracked frames; `rig`: the cameras in the log's order, by default the poses'."""
    rows = {index: row for row, index in enumerate(poses.index.tolist())}

    def pictures() -> Iterator[Image]:
        height = 0
        for frame in log[min(rows, default=0) : max(rows, default=-1) + 1]:
            if (row := rows.get(frame.index)) is not None:
                title = f"{poses.timestamp[row] - poses.timestamp[0]:.1f} s"
                shown = frame.images, rig or poses.about.rig, model
                height = height or len(tracker.viz.overlay(*shown, _widest(), title=title))
                yield _of_height(tracker.viz.overlay(*shown, observation(poses, row), title=title), height)
                progress(1)

    tracker.viz.write_film(path, pictures(), film_rate(poses.timestamp))


def poses_of(path: Path, object_name: str | None) -> tuple[tracker.Poses, tracker.CuboidModel]:
    """Read poses and load their object, as `object_name` if given; UsageError if that is another object."""
    poses = tracker.read_poses(path)
    its = poses.about.object_name
    if object_name is None and its not in object_names():
        raise click.UsageError(f"--object: expected the TOML file of {its!r}, of which {path} has poses")
    model = tracker.load_object(object_name or its)
    if model.name != its:
        raise click.UsageError(f"--object: found {model.name}, expected {its}: {path} has poses of {its}")
    return poses, model


def observation(poses: tracker.Poses, row: int) -> tracker.Observation:
    """Return the tracker's result for the frame in a row."""

    def of(columns: MeasuredColumns) -> dict[str, Any]:
        return {name: getattr(columns, name)[row] for name in columns.ROW_SHAPES}

    measured, filtered = poses.measured, poses.filtered
    uses = [] if poses.cameras is None else poses.cameras[row].tolist()
    return tracker.Observation(
        tracker.PoseEstimate(**of(measured)) if measured.has_pose[row] else None,
        tracker.MotionEstimate(**of(filtered)) if filtered.has_pose[row] else None,
        tracker.Status(str(poses.status[row])),
        cameras=tuple(tracker.CameraUse(use) for use in uses if use),
    )


def _widest() -> tracker.Observation:
    """Return an observation with the tallest caption that can occur."""
    moves = np.zeros(6), np.eye(6)
    pose = tracker.MotionEstimate(np.full(3, -0.12345), np.full(4, -0.5), np.eye(6), 1.0, *moves)
    return tracker.Observation(None, pose, max(tracker.Status, key=lambda status: len(status.value)))


def _of_height(picture: Image, height: int) -> Image:
    """Crop or pad an image to a height: captions wrap, but a film's images must have one size."""
    return np.pad(picture[:height], ((0, max(0, height - len(picture))), (0, 0), (0, 0)), mode="edge")


@command()
def export(
    *,
    source: Path = argument("POSES", InFile()),
    outputs: Outputs,
    parquet: Path | None = file_option("The table in Parquet.", ".parquet", ".pq", extra="cluster"),
    keypoints: bool = flag("Add the object's corners to --csv and --parquet."),
    robot_log: Path | None = option("FILE", "Add the robot's states to --csv and --parquet.", InFile()),
    log: Path | None = option("RECORDING", "The recording of the POSES, for --video.", Recording()),
    object_name: str | None = options.object_name("that of the POSES"),
    quiet: bool = flag("No progress bar."),
) -> None:
    """Write the poses of a file that `tracker track` made in other formats.

    Nothing is tracked again.
    """
    video = outputs.video
    if not outputs and parquet is None:
        every = "--csv, --parquet, --tum, --bop, --plot or --video"
        raise click.UsageError(f"found no file to write, expected {every}")
    if (video is None) != (log is None):
        raise click.UsageError("--video and --log belong together: a film needs the recording's images")
    for name, given in {"--keypoints": keypoints, "--robot-log": robot_log}.items():
        if given and outputs.csv is None and parquet is None:
            raise click.UsageError(f"{name}: found no table to add to, expected --csv or --parquet")
    model: tracker.CuboidModel | None = None
    if keypoints or video is not None or object_name is not None:
        poses, model = poses_of(source, object_name)
    else:  # no output needs the object, so it may be unknown
        poses = tracker.read_poses(source)
    outputs.check_camera(poses.about.rig)
    corners_of = model if keypoints else None
    more = read_robot_log(robot_log).at(poses.timestamp).columns() if robot_log else None
    if more and len(poses) and np.isinf(more["robot_gap_s"]).all():
        say(f"warning: {robot_log}: ends before the poses or begins after them: is it of the same job?")
    outputs.write(poses, corners_of, more)
    if parquet is not None:
        write_parquet(parquet, poses, keypoints_of=corners_of, more=more)
    if video is not None and log is not None and model is not None:
        with tracker.open_log(log, recover=True) as opened, bar("film", len(poses), quiet) as progress:
            rig = fitted_to(log, opened, poses.about.rig)
            refuse_others(source, poses, log, opened)
            write_tracked_film(video, opened, model, poses, progress, rig)


@command()
def convert(
    *,
    source: Path = argument("RECORDING", Recording()),
    output: Path = option(
        "FILE|DIR",
        "HDF5 recording (.h5), film of all cameras side by side (.mp4), or new folder of images.",
        AnyPath(),
        required=True,
    ),
    cameras: options.Cameras,
    part: options.Part,
    quiet: bool = flag("No progress bar."),
) -> None:
    """Write a recording and its calibration in another format.

    An HDF5 recording (the platform's version 2.1) keeps raw pixels, stamps, measured poses and the
    calibration. Colour images become the mosaic that the platform's cameras would have recorded. A folder
    of images (one PNG per camera) keeps frames' numbers, stamps and the calibration, too.
    """
    refuse_overwriting({"-o": output}, (source,), cameras.calibration)
    suffix = output.suffix.lower()
    if suffix not in (".h5", ".hdf5", ".mp4", ""):
        expected = ".h5, .mp4, or none for a folder"
        raise click.UsageError(f"-o {output}: found suffix {suffix!r}, expected {expected}")
    if suffix == ".mp4" and any(astuple(cameras)):
        raise click.UsageError(f"-o {output}: a film keeps no calibration, expected no options about it")
    require_folder("-o", output, parent_of(output), made=False)
    if output.exists():
        raise click.UsageError(f"-o {output}: exists, expected a new name")
    with tracker.open_log(source, recover=part.recover) as log:
        chosen = part.of(source, len(log))
        frames = log[chosen.start : chosen.stop]
        with bar(source.name, len(frames), quiet) as progress:
            if suffix == ".mp4":
                write_log_film(output, frames, progress)
            else:
                rig = cameras.rig_of(source, log)
                if suffix:
                    write_hdf5(output, frames, rig, progress)
                elif (written := write_folder(output, frames, rig, progress)) != len(frames):
                    why = "those without readable images are left out"
                    say(f"warning: {output}: {len(frames)} frames become {written}: {why}")
                if count := sum(chosen.start < first < chosen.stop for first in log.episode_starts):
                    say(f"warning: {source}: its {count + 1} episodes become one recording without a break")
    if log.fault is not None:
        say(f"warning: {log.fault}")


_Frames = Iterator[tuple[int, float, "tracker.Observation", Sequence["Image | None"], "Sample | None"]]
"""Arguments of `Scene.show` for each frame."""


@command()
def view(
    *,
    source: Path = argument("RECORDING|POSES", Recording()),
    log: Path | None = option("RECORDING", "The recording of the POSES, for its images.", Recording()),
    object_name: str | None = options.object_name("that of the POSES"),
    cameras: options.Cameras,
    output: Path | None = file_option(
        "Write a file for the viewer (.rrd).  [default: open the viewer; without a screen, a file here]",
        ".rrd",
    ),
    colors_name: str | None = options.colors(),
    part: options.Part,
    every: int = options.whole("Show every Nth frame.", default=1),
    quiet: bool = flag("No progress bar, and nothing about the file."),
) -> None:
    """Show a recording and its poses in the viewer Rerun.

    Shows cameras, images, poses, uncertainty, status and rig health. POSES is a file that `tracker track`
    wrote; --log adds the images of its recording. A RECORDING alone is tracked first, which needs --object.

    The viewer is Rerun: python3 -m pip install -e '.[rerun]'. `rerun FILE.rrd` opens a file.
    """
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
            every_frame = answers(source, opened[part.start : part.stop], finder)
            frames = _looked_at(finder, (one for one in every_frame if one[0].index in chosen))
        scene = stack.enter_context(open_scene(target, rig, model))
        progress = stack.enter_context(bar(source.name, total, quiet))
        for frame in frames:
            scene.show(*frame)
            progress(1)
    if target is not None and not quiet:
        click.echo(f"wrote {target}; rerun {shlex.quote(str(target))} shows it")


def _of_poses(
    stack: ExitStack, source: Path, log: Path | None, object_name: str | None, part: options.Part, every: int
) -> tuple[tracker.CuboidModel, tracker.CameraRig, int, _Frames]:
    """Return object, cameras, number of frames, and frames with images of `log`, which `stack` closes."""
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
    """Yield frames with the tracker's results, images, and samples of rig health."""
    for frame, answer in answered:
        look = sample(finder, frame.images, still=surely_still(answer.filtered_object_pose))
        yield frame.index, frame.newest, answer, frame.images, look


def _target(source: Path, output: Path | None) -> Path | None:
    """Return the file to write, or None to open a viewer."""
    screen = sys.platform == "darwin" or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    if output is not None or screen:
        return output
    target = Path(f"{source.resolve().stem}.rrd")
    if target.exists():
        raise click.UsageError(f"no screen for the viewer, and {target} exists; expected -o FILE")
    return target
