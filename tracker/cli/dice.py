"""`tracker dice`: where the dice are, and the error of the dice task."""

from __future__ import annotations

import dataclasses
import json
import math
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import tracker
from tracker.cli import options
from tracker.cli.outputs import PICTURE, Command, InFile, OutFolder, Recording, file_option
from tracker.cli.pictures import NO_IMAGE, frame_option, one_set
from tracker.cli.render import listing, table

if TYPE_CHECKING:
    from tracker.conventions import FloatArray, Image
    from tracker.tasks.rearrange_dice import Assignment, Die

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
@click.argument("images", nargs=-1, required=True, metavar="IMAGE...", type=Recording(str))
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

    Give one image file (.png, .jpg) per camera; or one recording (.dat, .h5) or folder of images, and the
    number of its --frame. A recording brings its calibration, unless --calibration names another. Files named
    after the cameras may come in any order; a name that contradicts the cameras is an error. Other files come
    in the order of the cameras, which is that of the numbers in the calibration files' names. 'none' stands
    for a missing image; its camera does not count.
    """
    from tracker.tasks.rearrange_dice import read_goal

    goal = None if goal_path is None else read_goal(goal_path)
    rig, pictures = one_set(images, cameras, frame)
    _evaluate(rig, pictures, goal, exact)  # loads compiled code: times are to be those of a running loop
    state = _evaluate(rig, pictures, goal, exact)
    if masks is not None:
        _write_masks(masks, rig, state)
    if overlay is not None:
        found: dict[str, Any] = {
            "positions": [die.position for die in state.dice],
            "assignment": state.assignment,
        }
        picture = tracker.viz.dice_overlay(pictures, rig, state.goal_masks, state.dice_masks, **found)
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


def _write_masks(folder: Path, rig: tracker.CameraRig, state: _State) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for index, name in enumerate(rig.names):
        mask = state.dice_masks[index]
        if mask is not None:
            tracker.viz.write_image(folder / f"dice_{name}.png", mask)
        if state.goal_masks is not None:
            tracker.viz.write_image(folder / f"goal_{name}.png", state.goal_masks[index])


def _json(rig: tracker.CameraRig, state: _State) -> str:
    result: dict[str, Any] = {
        "error": state.error,
        "error_per_camera": None if state.errors is None else dict(zip(rig.names, state.errors, strict=True)),
        "reward": None if state.error is None else -state.error,
        "dice": [
            {"position": die.position.tolist(), "yaw": float(die.yaw), "probability": float(die.probability)}
            for die in state.dice
        ],
        "assignment": None,
    }
    if state.assignment is not None:
        distances = state.assignment.distance
        result["assignment"] = [
            {"goal": place, "die": die, "distance": float(distances[place])}
            for place, die in state.assignment.pairs
        ]
    return json.dumps({**result, "timing_ms": state.timing_ms}, allow_nan=False)


def _text(rig: tracker.CameraRig, state: _State) -> str:
    from tracker.tasks.rearrange_dice import TOLERANCE

    rows = []
    if state.errors is not None:
        values = [NO_IMAGE if value is None else str(value) for value in state.errors]
        each = ", ".join(f"{name} {value}" for name, value in zip(rig.names, values, strict=True))
        rows.append(["error [px]", f"{state.error} ({each})"])
    found = f"{len(state.dice)} found"
    if state.assignment is not None:
        found += (
            f", {state.assignment.count_within()} within {1e3 * TOLERANCE:g} mm of their place in the goal"
        )
    rows.append(["dice", found])
    times = ", ".join(f"{stage} {value:.2f}" for stage, value in state.timing_ms.items())
    rows.append(["time [ms]", times])
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
