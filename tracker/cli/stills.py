"""`tracker detect` and `tracker dice`, and reading one set of images for commands."""

import contextlib
import dataclasses
import json
import math
import os
import sys
import time
from collections.abc import Container, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import click
import numpy as np

import tracker
from tracker.checks import shows
from tracker.cli import options
from tracker.cli.options import command, file_option, flag, option, several
from tracker.cli.outputs import DRAWN, InFile, OutFolder, Recording, is_recording, refuse_overwriting
from tracker.cli.terminal import listing, say, table
from tracker.color_learning.labelled import read_image
from tracker.conventions import FloatArray, Image
from tracker.errors import ImageError, LogError
from tracker.inputs import NO_IMAGE, of_cameras
from tracker.logs.opening import sized_for
from tracker.summaries.remarks import DOUBTFUL, likely_cause, off_table
from tracker.tasks.rearrange_dice import Assignment

_images = several("IMAGE", Recording(str))
_frame = options.whole("Which frame of a recording or folder.  [default: 0]", least=0)


def _one_set(
    images: Sequence[str], cameras: options.Cameras, frame: int | None
) -> tuple[tracker.CameraRig, list[Image | None]]:
    """Return the cameras and their images in order; a path alone that is no image is a recording."""
    if len(images) == 1 and images[0] != NO_IMAGE and is_recording(images[0]):
        path, number = Path(images[0]), frame or 0
        with tracker.open_log(path) as log:
            rig = cameras.rig_of(path, log)
            if number >= len(log):
                there = f"0 to {len(log) - 1}" if len(log) else "a recording that has some"
                raise LogError(f"{path}: found no frame {number}, expected one from {there}")
            pictures = list(log[number].images)
            if all(one is None for one in pictures):
                raise LogError(f"{path}: found frame {number} without images, expected another --frame")
            return rig, pictures
    if frame is not None:
        raise click.UsageError("--frame is for recordings and folders; found image files")
    if not cameras.calibration:
        raise click.UsageError(
            "Missing option '--calibration': the folder with a file per camera, such as camera60.yml"
        )
    rig = cameras.load()
    return read_images(images, rig, resize=rig.names if cameras.resize_calibration else ())


def read_images(
    paths: Sequence[str], rig: tracker.CameraRig, *, resize: Container[str]
) -> tuple[tracker.CameraRig, list[Image | None]]:
    """Return the rig for the images' sizes, and the images in its order; None for a missing image.

    resize: names of the cameras whose calibration may be scaled.
    """
    images: list[Image | None] = []
    cameras = []
    for path, camera in zip(of_cameras(paths, rig.names), rig, strict=True):
        image = None
        if path != NO_IMAGE:
            with silent_libraries():
                image = read_image(Path(path))
            size = image.shape[1], image.shape[0]
            camera = sized_for(size, camera, f"image {path}", resize=camera.name in resize)
        images.append(image)
        cameras.append(camera)
    return dataclasses.replace(rig, cameras=tuple(cameras)), images


@contextlib.contextmanager
def silent_libraries() -> Iterator[None]:
    """Discard what compiled libraries write to stderr, e.g. libpng's warnings about a broken file."""
    if sys.stderr is None:  # closed by the parent process
        yield
        return
    sys.stderr.flush()
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    try:
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


@command()
def detect(
    *,
    images: tuple[str, ...] = _images,
    subject: options.Subject,
    cameras: options.Cameras,
    frame: int | None = _frame,
    as_json: bool = options.as_json,
    overlay: Path | None = file_option("Write the images with the pose drawn in (.png, .jpg).", *DRAWN),
    tell: bool = flag("Exit with 1 if the object is not found.", name="--exit-code"),
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
    model, colors = subject.load()
    rig, pictures = _one_set(images, cameras, frame)
    finder = tracker.ObjectTracker(model, rig, colors)
    finder.detect(pictures)  # load compiled code first: printed times are those of a running tracker
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
        click.echo(listing([*rows, _time_row(times)]))
    if warning is not None:
        say(f"warning: {warning}")
    if tell and pose is None:
        raise click.exceptions.Exit(1)


def _pose_rows(pose: tracker.PoseEstimate) -> list[list[str]]:
    std = np.sqrt(np.diag(pose.covariance))
    rows = [["", "".join(f"{axis:>11}" for axis in "xyzw")]]
    for label, values, digits in (
        ("position [mm]", 1e3 * pose.position, 3),
        ("  std [mm]", 1e3 * std[:3], 3),
        ("orientation", pose.orientation, 6),
        ("rotation vector [°]", np.degrees(tracker.geometry.so3.log(pose.rotation)), 3),
        ("rotation std [°]", np.degrees(std[3:]), 3),
    ):
        rows.append([label, "".join(f"{value:11.{digits}f}" for value in values)])
    return [*rows, ["confidence", f"{pose.confidence:.4f}, of being within 5 mm and 5°"]]


@command()
def dice(
    *,
    images: tuple[str, ...] = _images,
    cameras: options.Cameras,
    frame: int | None = _frame,
    goal_path: Path | None = option(
        "FILE", "The goal: JSON, or a pattern of 17 rows of characters.", InFile(), name="--goal"
    ),
    exact: bool = flag("Goal areas to the pixel, not cut to whole pixels as the platform's."),
    as_json: bool = options.as_json,
    overlay: Path | None = file_option("Write the images with dice and goal drawn in (.png, .jpg).", *DRAWN),
    masks: Path | None = option("DIR", "Write the masks of dice and goal (.png).", OutFolder()),
) -> None:
    """Find the dice in one IMAGE per camera, and the task's error.

    The error is the number of pixels, over all cameras, that show dice where the goal has none. Without
    --goal there is no error.

    IMAGEs, recordings and their calibration are given as to `tracker detect`. The camera of a missing image,
    'none' or black, does not count.
    """
    if exact and goal_path is None:
        raise click.UsageError("--exact: expected with --goal, whose areas it means")
    goal = None if goal_path is None else tracker.tasks.rearrange_dice.read_goal(goal_path)
    rig, pictures = _one_set(images, cameras, frame)
    pictures = [picture if shows(picture) else None for picture in pictures]
    if all(picture is None for picture in pictures):
        raise ImageError("images: found only black ones, expected at least one that is not")
    files = [masks / f"{kind}_{name}.png" for kind in ("dice", "goal") for name in rig.names] if masks else []
    given = [Path(path) for path in images if path != NO_IMAGE]
    drawn = {} if overlay is None else {"--overlay": overlay}
    refuse_overwriting(drawn | {f"--masks ({file.name})": file for file in files}, given)
    for file, source in zip(files, [*pictures, *[goal] * len(rig)], strict=False):
        if source is None and file.exists():
            raise click.UsageError(f"--masks {masks}: found {file.name} of another run, expected none")
    _evaluate(rig, pictures, goal, exact)  # load compiled code, so that times are those of a running loop
    found, dice_masks, goal_masks, assignment = _evaluate(rig, pictures, goal, exact)
    if masks is not None:
        masks.mkdir(parents=True, exist_ok=True)
        for file, mask in zip(files, (*dice_masks, *(goal_masks or ())), strict=False):
            if mask is not None:
                tracker.viz.write_image(file, mask)
    if overlay is not None:
        shown, centers = (pictures, rig, goal_masks, dice_masks), [die["position"] for die in found["dice"]]
        picture = tracker.viz.dice_overlay(*shown, positions=centers, assignment=assignment)
        tracker.viz.write_image(overlay, picture)
    click.echo(json.dumps(found, allow_nan=False) if as_json else _text(found))


def _evaluate(
    rig: tracker.CameraRig, images: Sequence[Image | None], goal: FloatArray | None, exact: bool
) -> tuple[dict[str, Any], list[Image | None], list[Image] | None, Assignment | None]:
    """Return the results to print, masks of the dice (None without an image) and goal, and the assignment."""
    task = tracker.tasks.rearrange_dice
    marks = [time.perf_counter()]
    masks = [None if image is None else task.segment_dice(image) for image in images]
    marks.append(time.perf_counter())
    goals, errors, error = None, None, None
    if goal is not None:
        goals = task.goal_masks(rig, goal, exact=exact)
        errors = dict(zip(rig.names, task.error_per_camera(goals, masks), strict=True))
        error = task.error(goals, masks)
    marks.append(time.perf_counter())
    dice = task.locate(rig, masks, images)
    assignment = None if goal is None else task.assign(goal, [die.position for die in dice])
    marks.append(time.perf_counter())
    stages = zip(("segmentation", "error", "location"), marks[:-1], marks[1:], strict=True)
    found = {
        "error": error,
        "error_per_camera": errors,
        "reward": None if error is None else -error,
        "dice": [
            {"position": die.position.tolist(), "yaw": float(die.yaw), "probability": float(die.probability)}
            for die in dice
        ],
        "assignment": assignment
        and [
            {"goal": place, "die": die, "distance": float(assignment.distance[place])}
            for place, die in assignment.pairs
        ],
        "timing_ms": {
            **{name: 1e3 * (end - begin) for name, begin, end in stages},
            "total": 1e3 * (marks[-1] - marks[0]),
        },
    }
    return found, masks, goals, assignment


def _text(found: dict[str, Any]) -> str:
    tolerance = tracker.tasks.rearrange_dice.TOLERANCE
    summary = []
    if found["error"] is not None:
        errors = found["error_per_camera"].items()
        each = ", ".join(f"{name} {NO_IMAGE if value is None else value}" for name, value in errors)
        summary.append(["error [px]", f"{found['error']} ({each})"])
    count, assignment = f"{len(found['dice'])} found", found["assignment"]
    if assignment is not None:
        near = sum(pair["distance"] <= tolerance for pair in assignment)
        count += f", {near} within {1e3 * tolerance:g} mm of their place in the goal"
    summary += [["dice", count], _time_row(found["timing_ms"])]
    rows = [["die", "x [mm]", "y [mm]", "z [mm]", "yaw [°]", "probability"]]
    rows[0] += [] if assignment is None else ["place", "distance [mm]"]
    pairs = {pair["die"]: pair for pair in assignment or ()}
    for index, die in enumerate(found["dice"]):
        place = [f"{1e3 * value:.1f}" for value in die["position"]]
        row = [str(index), *place, f"{math.degrees(die['yaw']):.1f}", f"{die['probability']:.3f}"]
        if (pair := pairs.get(index)) is not None:
            row += [str(pair["goal"]), f"{1e3 * pair['distance']:.1f}"]
        rows.append(row)
    return "\n\n".join([listing(summary), *([table(rows)] if rows[1:] else [])])


def _time_row(times: Mapping[str, float]) -> list[str]:
    return ["time [ms]", ", ".join(f"{stage} {time:.2f}" for stage, time in times.items())]
