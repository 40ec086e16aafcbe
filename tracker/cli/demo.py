"""`tracker demo`: track a short recording that comes with the package; compare it with ground truth."""

import json
import math
import shlex
import shutil
from pathlib import Path

import click
import numpy as np

import tracker
from tracker.cli.options import command, option
from tracker.cli.outputs import OutFolder
from tracker.cli.terminal import listing
from tracker.errors import TrackerError
from tracker.files import whole_file, writing

DATA = Path(__file__).parents[1] / "demo"


@command()
def demo(
    output: Path = option(
        "DIR",
        "New folder for the recording and the picture.",
        OutFolder(),
        default="tracker-demo",
        show_default=True,
    ),
) -> None:
    """Find a cube in a recording that comes with the package, and compare with truth.

    The recording has two seconds of the simulated platform: three cameras at 10 Hz. The new folder DIR holds
    the recording, its calibration, and overlay.png: the first images with the pose drawn in. If the command
    is interrupted, there is no folder.
    """
    if output.exists():
        raise TrackerError(f"{output}: exists already; delete it, or name another folder with -o DIR")
    truths = json.loads((DATA / "truth.json").read_text(encoding="utf-8"))
    model = tracker.load_object(truths["object"])
    with (
        writing(TrackerError, output),
        whole_file(output) as folder,
        tracker.open_log(_copied(DATA, folder)) as log,
    ):
        assert log.rig is not None
        finder = tracker.ObjectTracker(model, log.rig)
        first = log.frame(0).images
        picture = tracker.viz.overlay(first, log.rig, model, finder.detect(first))
        tracker.viz.write_image(folder / "overlay.png", picture)
        answers = [finder.update(frame.images, frame.stamps) for frame in log]
    pairs = zip(answers, truths["poses"], strict=True)
    errors = np.array([_error(answer.filtered_object_pose, truth) for answer, truth in pairs])
    millimetres, degrees = np.nanmedian(errors, axis=0)
    time = np.median([answer.timing_ms["total"] for answer in answers])
    rows = [
        ("recording", f"{output}: {len(answers)} frames of {len(log.camera_names)} cameras, simulated"),
        ("found in", f"{int(np.isfinite(errors[:, 0]).sum())} frames"),
        ("median error", f"{millimetres:.2f} mm, {degrees:.2f} degrees from the truth"),
        ("median time", f"{time:.1f} ms a frame"),
        ("picture", str(output / "overlay.png")),
    ]
    click.echo(f"{listing(rows)}\n\nnext:")
    quoted = shlex.quote(str(output))
    click.echo(f"  tracker detect --object {model.name} {quoted} --frame 7")
    click.echo(f"  tracker track {quoted} --object {model.name} -o poses.h5 --csv poses.csv")


def _copied(source: Path, target: Path) -> Path:
    """Copy a folder; shutil.copytree would list every file that failed if the disk is full."""
    target.mkdir()
    for path in source.iterdir():
        copy = _copied if path.is_dir() else shutil.copyfile
        copy(path, target / path.name)
    return target


def _error(pose: tracker.PoseEstimate | None, truth: dict[str, list[float]]) -> tuple[float, float]:
    """Return distance [mm] and angle [deg] from the ground truth; NaN without a pose."""
    if pose is None:
        return math.nan, math.nan
    so3 = tracker.geometry.so3
    angle = so3.angle_between(pose.rotation, so3.matrix_from_quaternion(truth["orientation"]))
    return 1e3 * float(np.linalg.norm(pose.position - truth["position"])), math.degrees(angle)
