"""`tracker detect`: one pose from one set of images."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

import tracker
from tracker.cli import options
from tracker.cli.outputs import PICTURE, Command, Recording, file_option
from tracker.cli.pictures import frame_option, one_set
from tracker.cli.render import listing, say


@click.command(cls=Command)
@click.argument("images", nargs=-1, required=True, metavar="IMAGE...", type=Recording(str))
@options.subject
@options.cameras
@frame_option
@options.as_json
@file_option("--overlay", *PICTURE, help="Write the images with the pose drawn in (.png, .jpg).")
@click.option("--exit-code", "tell", is_flag=True, help="Exit with 1 if the object is not found.")
def detect(
    images: tuple[str, ...],
    subject: options.Subject,
    cameras: options.Cameras,
    frame: int | None,
    as_json: bool,
    overlay: Path | None,
    tell: bool,
) -> None:
    """Find an object in one IMAGE per camera.

    Give one image file (.png, .jpg) per camera; or one recording (.dat, .h5) or folder of images, and the
    number of its --frame. A recording brings its calibration, unless --calibration names another. Files named
    after the cameras may come in any order; a name that contradicts the cameras is an error. Other files come
    in the order of the cameras, which is that of the numbers in the calibration files' names. 'none' stands
    for a missing image.

    If the pose is missing or doubtful, a warning names the likely cause: swapped cameras, red and blue
    swapped, another object, bad exposure, blur. Other warnings: the cameras contradict each other, or the
    object seems to float above the table or sink into it.

    If the object is not found, the status says why. The exit code is 0 even then; with --exit-code it is 1.
    """
    from tracker.summaries.remarks import DOUBTFUL, likely_cause, off_table

    model, colors = subject.load()
    rig, pictures = one_set(images, cameras, frame)
    finder = tracker.ObjectTracker(model, rig, colors)
    finder.detect(pictures)  # loads the compiled code: the times printed are those of a running tracker
    observation = finder.detect(pictures)
    warning = likely_cause(finder, pictures, observation)
    if warning is None and observation.reason is tracker.Status.INCONSISTENT_VIEWS:
        warning = DOUBTFUL
    warning = warning or off_table(observation.object_pose, model, rig.arena)
    if overlay is not None:
        picture = tracker.viz.overlay(pictures, rig, model, observation, note=warning or "")
        tracker.viz.write_image(overlay, picture)
    click.echo(_json(model.name, observation) if as_json else _text(model.name, observation))
    if warning is not None:
        say(f"warning: {warning}")
    if tell and observation.object_pose is None:
        raise click.exceptions.Exit(1)


def _json(name: str, observation: tracker.Observation) -> str:
    pose = observation.object_pose
    result: dict[str, Any] = {"object": name, "status": observation.status.value, "pose": None}
    if pose is not None:
        result["pose"] = pose.as_json()
    result["timing_ms"] = {stage: float(time) for stage, time in observation.timing_ms.items()}
    return json.dumps(result, allow_nan=False)


def _text(name: str, observation: tracker.Observation) -> str:
    rows = [["object", name], ["status", observation.status.value]]
    times = ", ".join(f"{stage} {time:.2f}" for stage, time in observation.timing_ms.items())
    if observation.object_pose is not None:
        rows += _pose_rows(observation.object_pose)
    rows.append(["time [ms]", times])
    return listing(rows)


def _pose_rows(pose: tracker.PoseEstimate) -> list[list[str]]:
    import numpy as np

    from tracker.geometry import so3

    std = np.sqrt(np.diag(pose.covariance))
    rows = [["", "".join(f"{axis:>11}" for axis in "xyzw")]]
    for label, values, digits in (
        ("position [mm]", 1e3 * pose.position, 3),
        ("  std [mm]", 1e3 * std[:3], 3),
        ("orientation", pose.orientation, 6),
        ("rotation vector [°]", np.degrees(so3.log(pose.rotation)), 3),
        ("  std [°]", np.degrees(std[3:]), 3),
    ):
        rows.append([label, "".join(f"{value:11.{digits}f}" for value in values)])
    return [*rows, ["confidence", f"{pose.confidence:.4f}, of being within 5 mm and 5°"]]
