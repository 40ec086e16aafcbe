"""`tracker demo`: a short recording that comes with the package, tracked and compared with its truth."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import click

import tracker
from tracker.cli.outputs import Command, OutFolder
from tracker.cli.render import listing
from tracker.errors import TrackerError
from tracker.files import told_as, whole_file

DATA = Path(__file__).parents[1] / "demo"


@click.command(cls=Command, short_help="Find a cube in a recording that comes with the package.")
@click.option(
    "-o",
    "--output",
    type=OutFolder(),
    default="tracker-demo",
    show_default=True,
    metavar="DIR",
    help="New folder for the recording and the picture.",
)
def demo(output: Path) -> None:
    """Find a cube in a recording that comes with the package, and compare with truth.

    The recording has two seconds of the simulated platform: three cameras at 10 Hz. The new folder DIR holds
    the recording, its calibration, and overlay.png: the first images with the pose drawn in. If the command
    is interrupted, there is no folder.
    """
    import numpy as np

    if output.exists():
        raise TrackerError(f"{output}: exists; expected a new folder, as by --output")
    truths = json.loads((DATA / "truth.json").read_text(encoding="utf-8"))
    model = tracker.load_object(truths["object"])
    with (
        told_as(TrackerError, output),
        whole_file(output) as folder,
        tracker.open_log(shutil.copytree(DATA, folder)) as log,
    ):
        if log.rig is None:
            raise TrackerError(f"{output}: found no calibration in the recording")
        finder = tracker.ObjectTracker(model, log.rig)
        errors: list[list[float]] = []
        times: list[float] = []
        for frame, truth in zip(log, truths["poses"], strict=True):
            if not errors:
                still = finder.detect(frame.images)
                picture = tracker.viz.overlay(frame.images, log.rig, model, still)
                tracker.viz.write_image(folder / "overlay.png", picture)
            observation = finder.update(frame.images, frame.timestamp)
            pose = observation.filtered_object_pose
            errors.append([np.nan] * 2 if pose is None else _error(pose.world_from_object, truth))
            times.append(observation.timing_ms["total"])
    found = np.array(errors)
    millimetres, degrees = np.nanmedian(found, axis=0)
    rows = [
        ("recording", f"{output}: {len(found)} frames of {len(log.camera_names)} cameras, simulated"),
        ("found in", f"{int(np.isfinite(found[:, 0]).sum())} frames"),
        ("median error", f"{millimetres:.2f} mm, {degrees:.2f} degrees from the truth"),
        ("median time", f"{np.median(times):.1f} ms a frame"),
        ("picture", str(output / "overlay.png")),
    ]
    click.echo(listing(rows))
    click.echo("\nnext:")
    click.echo(f"  tracker detect --object {model.name} {output} --frame 7")
    click.echo(f"  tracker track {output} --object {model.name} -o poses.h5 --csv poses.csv")


def _error(found: tracker.conventions.FloatArray, truth: dict[str, list[float]]) -> list[float]:
    """Distance [mm] and angle [deg] from the truth."""
    import numpy as np

    from tracker.geometry import so3

    rotation = so3.matrix_from_quaternion(np.array(truth["orientation"]))
    angle = so3.angle_between(found[:3, :3], rotation)
    return [float(1e3 * np.linalg.norm(found[:3, 3] - truth["position"])), float(np.degrees(angle))]
