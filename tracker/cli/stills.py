"""`tracker detect` and `tracker dice`: what one set of images shows."""

from __future__ import annotations

import dataclasses
import json
import math
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

import tracker
from tracker.cli import options
from tracker.cli.outputs import PICTURE, Command, InFile, OutFolder, Recording, file_option
from tracker.cli.pictures import NO_IMAGE, frame_option, one_set
from tracker.cli.terminal import listing, say, table

if TYPE_CHECKING:
    from tracker.conventions import FloatArray, Image
    from tracker.tasks.rearrange_dice import Assignment, Die

_images = click.argument("images", nargs=-1, required=True, metavar="IMAGE...", type=Recording(str))


@click.command(cls=Command)
@_images
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
    pose, status, times = observation.object_pose, observation.status.value, observation.timing_ms
    if as_json:
        found = {"object": model.name, "status": status, "pose": pose and pose.as_json(), "timing_ms": times}
        click.echo(json.dumps(found, allow_nan=False))
    else:
        rows = [["object", model.name], ["status", status], *([] if pose is None else _pose_rows(pose))]
        rows.append(["time [ms]", ", ".join(f"{stage} {time:.2f}" for stage, time in times.items())])
        click.echo(listing(rows))
    if warning is not None:
        say(f"warning: {warning}")
    if tell and pose is None:
        raise click.exceptions.Exit(1)


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


_STAGES = ("segmentation", "error", "location")


@dataclasses.dataclass(frozen=True, eq=False)
class _State:
    dice_masks: list[Image | None]
    """Of each camera; None where it gave no image."""
    goal_masks: list[Image] | None
    errors: list[int | None] | None
    """Of each camera [px]; None where it gave no image. This and the next are None without a goal."""
    assignment: Assignment | None
    dice: tuple[Die, ...]
    timing_ms: dict[str, float]

    @property
    def error(self) -> int | None:
        return None if self.errors is None else sum(value for value in self.errors if value is not None)


@click.command(cls=Command, short_help="Find the dice in one IMAGE per camera, and the error.")
@_images
@options.cameras
@frame_option
@click.option(
    "--goal",
    "goal_path",
    metavar="FILE",
    type=InFile(),
    help="The goal: JSON, or a pattern of 17 rows of characters.",
)
@click.option(
    "--exact", is_flag=True, help="Goal areas to the pixel, not cut to whole pixels as the platform's."
)
@options.as_json
@file_option("--overlay", *PICTURE, help="Write the images with dice and goal drawn in (.png, .jpg).")
@click.option("--masks", metavar="DIR", type=OutFolder(), help="Write the masks of dice and goal (.png).")
def dice(
    images: tuple[str, ...],
    cameras: options.Cameras,
    frame: int | None,
    goal_path: Path | None,
    exact: bool,
    as_json: bool,
    overlay: Path | None,
    masks: Path | None,
) -> None:
    """Find the dice in one IMAGE per camera, and the task's error.

    The error is the number of pixels, over all cameras, that show dice where the goal has none. Without
    --goal there is no error.

    IMAGEs, recordings and their calibration are given as to `tracker detect`. The camera of a missing image,
    'none', does not count.
    """
    from tracker.tasks.rearrange_dice import read_goal

    goal = None if goal_path is None else read_goal(goal_path)
    rig, pictures = one_set(images, cameras, frame)
    _evaluate(rig, pictures, goal, exact)  # loads compiled code: times are to be those of a running loop
    state = _evaluate(rig, pictures, goal, exact)
    if masks is not None:
        masks.mkdir(parents=True, exist_ok=True)
        for kind, its in (("dice", state.dice_masks), ("goal", state.goal_masks or [])):
            for name, mask in zip(rig.names, its, strict=False):
                if mask is not None:
                    tracker.viz.write_image(masks / f"{kind}_{name}.png", mask)
    if overlay is not None:
        shown = pictures, rig, state.goal_masks, state.dice_masks
        centers = [die.position for die in state.dice]
        picture = tracker.viz.dice_overlay(*shown, positions=centers, assignment=state.assignment)
        tracker.viz.write_image(overlay, picture)
    click.echo(_json(rig, state) if as_json else _text(rig, state))


def _evaluate(
    rig: tracker.CameraRig, images: Sequence[Image | None], goal: FloatArray | None, exact: bool
) -> _State:
    from tracker.tasks import rearrange_dice as task

    marks = [time.perf_counter()]
    masks = [None if image is None else task.segment_dice(image) for image in images]
    marks.append(time.perf_counter())
    goals = None if goal is None else task.goal_masks(rig, goal, exact=exact)
    errors = None
    if goals is not None:
        errors = [
            None if mask is None else task.error([goal_mask], [mask])
            for goal_mask, mask in zip(goals, masks, strict=True)
        ]
    marks.append(time.perf_counter())
    seen = [parts for parts in zip(rig, masks, images, strict=True) if parts[1] is not None]
    cameras, their_masks, their_images = zip(*seen, strict=True)
    found = task.locate(dataclasses.replace(rig, cameras=cameras), their_masks, their_images)
    positions = [die.position for die in found]
    assignment = None if goal is None else task.assign(goal, positions)
    marks.append(time.perf_counter())
    stages = {name: 1e3 * (b - a) for name, a, b in zip(_STAGES, marks[:-1], marks[1:], strict=True)}
    timing = {**stages, "total": 1e3 * (marks[-1] - marks[0])}
    return _State(masks, goals, errors, assignment, found, timing)


def _json(rig: tracker.CameraRig, state: _State) -> str:
    assigned = state.assignment and [
        {"goal": place, "die": die, "distance": float(state.assignment.distance[place])}
        for place, die in state.assignment.pairs
    ]
    result = {
        "error": state.error,
        "error_per_camera": state.errors and dict(zip(rig.names, state.errors, strict=True)),
        "reward": None if state.error is None else -state.error,
        "dice": [
            {"position": die.position.tolist(), "yaw": float(die.yaw), "probability": float(die.probability)}
            for die in state.dice
        ],
        "assignment": assigned,
        "timing_ms": state.timing_ms,
    }
    return json.dumps(result, allow_nan=False)


def _text(rig: tracker.CameraRig, state: _State) -> str:
    from tracker.tasks.rearrange_dice import TOLERANCE

    rows = []
    if state.errors is not None:
        pairs = zip(rig.names, state.errors, strict=True)
        each = ", ".join(f"{name} {NO_IMAGE if value is None else value}" for name, value in pairs)
        rows.append(["error [px]", f"{state.error} ({each})"])
    found = f"{len(state.dice)} found"
    if state.assignment is not None:
        near = state.assignment.count_within()
        found += f", {near} within {1e3 * TOLERANCE:g} mm of their place in the goal"
    rows.append(["dice", found])
    rows.append(["time [ms]", ", ".join(f"{stage} {ms:.2f}" for stage, ms in state.timing_ms.items())])
    return "\n\n".join([listing(rows), *([table(_dice_rows(state))] if state.dice else [])])


def _dice_rows(state: _State) -> list[list[str]]:
    rows = [["die", "x [mm]", "y [mm]", "z [mm]", "yaw [°]", "probability"]]
    for index, die in enumerate(state.dice):
        x, y, z = (f"{1e3 * value:.1f}" for value in die.position)
        yaw = f"{math.degrees(die.yaw):.1f}"
        rows.append([str(index), x, y, z, yaw, f"{die.probability:.3f}"])
    if state.assignment is not None:
        partners = {die: place for place, die in state.assignment.pairs}
        rows[0] += ["place", "distance [mm]"]
        for index, row in enumerate(rows[1:]):
            if index in partners:
                place = partners[index]
                row += [str(place), f"{1e3 * state.assignment.distance[place]:.1f}"]
    return rows
