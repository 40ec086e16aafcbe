"""`tracker detect`: one pose from one set of images."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tracker.cli.options import Cameras, calibration_options, colors_option, json_option, object_option
from tracker.cli.outputs import PICTURE, Command, OutFile, Recording
from tracker.cli.pictures import frame_option
from tracker.cli.render import listing

if TYPE_CHECKING:
    from tracker.conventions import Image
    from tracker.pipeline import ObjectTracker
    from tracker.pose.result import Observation, PoseEstimate


@click.command(cls=Command)
@click.argument("images", nargs=-1, required=True, metavar="IMAGE...", type=Recording(str))
@object_option()
@calibration_options
@frame_option
@colors_option()
@json_option
@click.option(
    "--overlay",
    metavar="FILE",
    type=OutFile(*PICTURE),
    help="Write the images with the pose drawn in (.png, .jpg).",
)
@click.option("--exit-code", "tell", is_flag=True, help="Exit with 1 where the object is not found.")
def detect(
    images: tuple[str, ...],
    object_name: str,
    cameras: Cameras,
    frame: int | None,
    colors_name: str | None,
    as_json: bool,
    overlay: Path | None,
    tell: bool,
) -> None:
    """Find an object's pose in one IMAGE of each camera.

    IMAGE is a picture file (.png, .jpg) of each camera; or one recording (.dat, .h5), or one folder of
    pictures, of which --frame is taken, with its own calibration unless one is given. Files that are named
    after the cameras go to these, and names that contradict them are an error; files without such names
    come in the order of the cameras: in a folder of calibrations that of the numbers in their names, else
    that of the files given. 'none' in place of an IMAGE: that camera gave none.

    Pictures that fit only in another order of the cameras are told of; they are taken as they are given.

    The exit code is 0 also when the object is not found: then there is no pose, and the status says why.
    With --exit-code it is 1.
    """
    from tracker.cli.pictures import one_set
    from tracker.objects.model import load_object
    from tracker.pipeline import ObjectTracker
    from tracker.segmentation.color_model import load_colors

    model = load_object(object_name)
    colors = None if colors_name is None else load_colors(colors_name)
    rig, pictures = one_set(images, cameras, frame)
    tracker = ObjectTracker(model, rig, colors)
    tracker.detect(pictures)  # loads the compiled code: the times printed are those of a running tracker
    observation = tracker.detect(pictures)
    if overlay is not None:
        from tracker import viz

        viz.write_image(overlay, viz.overlay(pictures, rig, model, observation))
    click.echo(_json(model.name, observation) if as_json else _text(model.name, observation))
    _warn(tracker, pictures, observation, rig.names)
    if tell and observation.object_pose is None:
        raise click.exceptions.Exit(1)


def _warn(
    tracker: ObjectTracker, images: Sequence[Image | None], answer: Observation, names: Sequence[str]
) -> None:
    """Say so of one set of pictures, with what was found in it."""
    from tracker.summaries.swapped import mistaken, swapped, told

    order = swapped(tracker, images, answer)
    said = mistaken(tracker, images, answer) if order is None else told(order, names)
    if said is not None:
        click.echo(f"tracker: warning: {said}", err=True)


def _json(name: str, observation: Observation) -> str:
    pose = observation.object_pose
    result: dict[str, Any] = {"object": name, "status": observation.status.value, "pose": None}
    if pose is not None:
        result["pose"] = pose.as_json()
    result["timing_ms"] = {stage: float(time) for stage, time in observation.timing_ms.items()}
    return json.dumps(result, allow_nan=False)


def _text(name: str, observation: Observation) -> str:
    rows = [["object", name], ["status", observation.status.value]]
    times = ", ".join(f"{stage} {time:.2f}" for stage, time in observation.timing_ms.items())
    if observation.object_pose is not None:
        rows += _pose_rows(observation.object_pose)
    rows.append(["time [ms]", times])
    return listing(rows)


def _pose_rows(pose: PoseEstimate) -> list[list[str]]:
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
