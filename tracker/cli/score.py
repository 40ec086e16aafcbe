"""`tracker score`: compute the rewards of a job."""

import json
from dataclasses import astuple
from pathlib import Path
from typing import Any, TypeAlias

import click
import numpy as np

import tracker
from tracker.checks import shows
from tracker.cli import options
from tracker.cli.export import poses_of
from tracker.cli.options import argument, command, flag, option
from tracker.cli.outputs import InFile
from tracker.cli.terminal import bar, listing
from tracker.conventions import Array, FloatArray
from tracker.errors import LogError, TaskError
from tracker.summaries.summary import best, goal_file, refuse_others, scored, seconds_since_beginning, totals
from tracker.tasks import rearrange_dice
from tracker.tasks.job_goal import JobGoal, read_job_goal

Rewards: TypeAlias = tuple[FloatArray, FloatArray, Array, dict[str, float | None]]
"""Times (n,) [s] and rewards (n,) of all frames, (n,) whether each was seen, and the totals."""


@command()
def score(
    *,
    job: Path = argument("JOB", InFile()),
    goal_path: Path | None = option("FILE", "Goal.  [default: JOB/goal.json]", InFile(), name="--goal"),
    poses_path: Path | None = option("POSES", "Poses, instead of tracking.", InFile(), name="--poses"),
    object_name: str | None = options.object_name("that of the --poses"),
    cameras: options.Cameras,
    every: int = options.whole("Look for dice in every Nth frame.", default=1),
    as_json: bool = flag("Print one JSON object, with the reward of each frame.", name="--json"),
    quiet: bool = flag("No progress bar."),
) -> None:
    """Compute the rewards of a job's folder for its task.

    The task is to move an object, to move it along a trajectory, or to arrange dice. Time counts from the
    recording's first frame. A pose holds until the next frame in which the object is seen.
    """
    if goal_path is None and not goal_file(job).is_file():
        raise TaskError(f"{job}: found no {goal_file(job)}, expected one there or --goal")
    goal = read_job_goal(goal_path or goal_file(job))
    if goal.task == "rearrange_dice":
        if poses_path is not None or object_name is not None:
            raise click.UsageError("--poses, --object: not for a goal of dice, which are found in the images")
        seconds, rewards, seen, over_time = _of_dice(job, goal, cameras, every, quiet)
    else:
        if every != 1:
            raise click.UsageError(f"--every {every}: only for a goal of dice")
        seconds, rewards, seen, over_time = _of_object(job, goal, cameras, poses_path, object_name, quiet)
    listed = [value if known else None for value, known in zip(rewards.tolist(), seen.tolist(), strict=True)]
    count = len(listed) - listed.count(None)
    found: dict[str, Any] = {"level": goal.level, "frames": len(listed), "scored_frames": count, **over_time}
    if as_json:
        every_frame = {"seconds": seconds.tolist(), "rewards": listed}
        click.echo(json.dumps({"task": goal.task, **found, **every_frame}, allow_nan=False))
        return
    rows = [["task", goal.task]]
    for name, value in found.items():
        rows.append([name.replace("_", " "), "none" if value is None else f"{value:.6g}"])
    click.echo(listing(rows))


def _of_object(
    job: Path,
    goal: JobGoal,
    cameras: options.Cameras,
    poses_path: Path | None,
    object_name: str | None,
    quiet: bool,
) -> Rewards:
    """Return the rewards of the object's poses."""
    if poses_path is not None:
        if any(astuple(cameras)):
            raise click.UsageError(f"{poses_path}: the calibration is in this file of poses, expected none")
        poses, model = poses_of(poses_path, object_name)
        _refuse_others(poses_path, poses, job)
    elif object_name is None:
        raise click.UsageError("expected --poses of this recording, or --object to track it")
    else:
        model = tracker.load_object(object_name)
        with tracker.open_log(job) as log:
            count, rig = len(log), cameras.rig_of(job, log)
        with bar(job.name, count, quiet) as progress:
            poses = tracker.track(job, model, rig=rig, progress=progress).poses
    columns, seconds = best(poses), seconds_since_beginning(job, poses)
    rewards, over_time = scored(goal, columns, seconds, model)
    return seconds, rewards, columns.has_pose, over_time


def _refuse_others(path: Path, poses: tracker.Poses, job: Path) -> None:
    """Raise LogError for poses of another recording, if the job's recording exists."""
    try:
        log = tracker.open_log(job, recover=True)
    except LogError:
        if job.exists():  # often only a job's poses and goal are kept
            return
        raise
    with log:
        refuse_others(path, poses, job, log)


def _of_dice(job: Path, goal: JobGoal, cameras: options.Cameras, every: int, quiet: bool) -> Rewards:
    """Like `_of_object`; the rewards are minus the number of pixels that show dice outside the goal."""
    assert goal.position is not None
    stamps, rewards = [], []
    with tracker.open_log(job) as log, bar(job.name, len(log), quiet) as progress:
        masks = rearrange_dice.goal_masks(cameras.rig_of(job, log), goal.position)
        for k, frame in enumerate(log):
            images = [*filter(shows, frame.images)]  # HDF5 logs have black ones of cameras that gave none
            stamps.append(frame.timestamp)
            rewards.append(float("nan"))
            # The error is that of all cameras: with fewer it would be smaller.
            if k % every == 0 and len(images) == len(masks):
                rewards[k] = float(rearrange_dice.reward(masks, [*map(rearrange_dice.segment_dice, images)]))
            progress(1)
    seconds, found = np.array(stamps) - stamps[0] if stamps else np.zeros(0), np.array(rewards)
    return seconds, found, ~np.isnan(found), totals(found, seconds)
