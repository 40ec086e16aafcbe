"""What `tracker track` writes besides the file of poses."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import click

import tracker
from tracker.cli import options
from tracker.cli.outputs import file_option

if TYPE_CHECKING:
    from tracker.conventions import FloatArray, Image
    from tracker.poses.columns import MeasuredColumns
    from tracker.recordings import Recipe


@dataclass(frozen=True)
class Outputs:
    """Files that the user wants, None where he does not."""

    csv: Path | None
    tum: Path | None
    bop: Path | None
    camera: str | None
    """Whose BOP results."""
    video: Path | None
    plot: Path | None

    def __bool__(self) -> bool:
        """Whether any file is requested."""
        return any((self.csv, self.tum, self.bop, self.video, self.plot))

    def check_camera(self, rig: tracker.CameraRig) -> None:
        """Refuse a camera that the rig has not, and one without a file or the file without one."""
        if (self.bop is None) != (self.camera is None):
            raise click.UsageError("--bop and --camera belong together: BOP results are those of one camera")
        if self.camera is not None and self.camera not in rig.names:
            raise click.UsageError(f"--camera: found {self.camera}, expected one of {', '.join(rig.names)}")

    def write(self, poses: tracker.Poses, keypoints_of: tracker.CuboidModel | None = None) -> None:
        """Write all but the film; the table with the corners of an object, if one is given."""
        from tracker.poses.exports import write_bop, write_csv, write_tum
        from tracker.summaries.summary import best_kind

        kind = best_kind(poses)
        if self.csv is not None:
            write_csv(self.csv, poses, keypoints_of=keypoints_of)
        if self.tum is not None:
            write_tum(self.tum, poses, kind)
        if self.bop is not None:
            rig = poses.about.rig
            write_bop(self.bop, poses, rig[rig.names.index(self.camera or "")], kind)
        if self.plot is not None:
            tracker.viz.write_trajectory_plot(self.plot, poses)


output_options = options.gathered(
    "outputs",
    Outputs,
    file_option("--csv", ".csv", help="The poses as a table, one line a frame."),
    file_option("--tum", ".tum", ".txt", help="A trajectory in the TUM format."),
    file_option("--bop", ".csv", help="BOP results of the --camera."),
    click.option("--camera", metavar="NAME", help="Camera of the BOP results, e.g. camera60."),
    file_option("--video", ".mp4", extra="video", help="A film of the frames with the pose drawn in (.mp4)."),
    file_option("--plot", ".png", extra="plot", help="A plot of the poses over time (.png)."),
)
"""The options of both, see Outputs."""


def write_tracked_film(
    path: Path,
    log: tracker.Log,
    model: tracker.CuboidModel,
    poses: tracker.Poses,
    progress: Callable[[int], None],
) -> None:
    """Write a film of the frames that have been tracked, one in memory at a time."""
    from tracker.viz.image_files import film_rate, write_film

    write_film(path, _pictures(log, model, poses, progress), film_rate(poses.timestamp))


def write_health_page(
    path: Path, log: tracker.Log, recipe: Recipe, poses: tracker.Poses, progress: Callable[[int], None]
) -> list[str]:
    """Write a page on the rig's health over the tracked frames; what is not well, or missing."""
    from tracker.calibration.by_object.health import health
    from tracker.viz.calibration import write_health

    found = health(tracker.ObjectTracker(recipe.model, poses.about.rig, recipe.colors), log, poses, progress)
    write_health(path, found, " · ".join(filter(None, (poses.about.object_name, poses.about.source))))
    missing = found.missing()
    return found.complaints() + ([] if missing is None else [missing])


def _pictures(
    log: tracker.Log, model: tracker.CuboidModel, poses: tracker.Poses, progress: Callable[[int], None]
) -> Iterator[Image]:
    rows = {index: row for row, index in enumerate(poses.index.tolist())}
    if not rows:
        return
    rig = poses.about.rig
    height: int | None = None
    for frame in log[int(poses.index[0]) : int(poses.index[-1]) + 1]:
        row = rows.get(frame.index)
        if row is None:
            continue
        title = f"{poses.timestamp[row] - poses.timestamp[0]:.1f} s"
        if height is None:
            height = len(tracker.viz.overlay(frame.images, rig, model, _widest(), title=title))
        yield _of_height(
            tracker.viz.overlay(frame.images, rig, model, observation(poses, row), title=title), height
        )
        progress(1)


def observation(poses: tracker.Poses, row: int) -> tracker.Observation:
    """What the tracker answered to a frame."""

    def of(columns: MeasuredColumns) -> tuple[FloatArray, FloatArray, FloatArray, float]:
        arrays = columns.position[row], columns.orientation[row], columns.covariance[row]
        return *arrays, float(columns.confidence[row])

    measured, filtered = poses.measured, poses.filtered
    motion = filtered.velocity[row], filtered.velocity_covariance[row]
    uses = [] if poses.cameras is None else poses.cameras[row].tolist()
    return tracker.Observation(
        tracker.PoseEstimate(*of(measured)) if measured.has_pose[row] else None,
        tracker.MotionEstimate(*of(filtered), *motion) if filtered.has_pose[row] else None,
        tracker.Status(str(poses.status[row])),
        cameras=tuple(tracker.CameraUse(use) for use in uses if use),
    )


def _widest() -> tracker.Observation:
    """An answer whose caption is as high as any."""
    import numpy as np

    pose = tracker.PoseEstimate(np.full(3, -0.12345), np.full(4, -0.5), np.eye(6), 1.0)
    return tracker.Observation(pose, None, max(tracker.Status, key=lambda status: len(status.value)))


def _of_height(picture: Image, height: int) -> Image:
    """Captions wrap, but the pictures of a film are of one size."""
    import numpy as np

    missing = max(0, height - len(picture))
    rows = np.repeat(picture[-1:], missing, axis=0)  # the caption's ground
    return np.concatenate([picture[:height], rows])
