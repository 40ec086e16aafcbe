"""Rewards of a recording's poses for the goal in its folder: whether it is theirs, and when it began."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from tracker.conventions import FloatArray
from tracker.errors import LogError, TaskError, reason
from tracker.logs import Log, open_log
from tracker.objects.model import CuboidModel
from tracker.poses.poses import Poses
from tracker.summaries.summary import best
from tracker.tasks.job_goal import FILE_NAME, STEPS_PER_SECOND, read_job_goal

SAME = 1e-3  # time [s] by which stamps of one frame may differ: formats round them


def refuse_others(path: Path, poses: Poses, recording: Path, log: Log) -> None:
    """LogError for poses of another recording, by number and stamp of first and last frame."""
    if not len(poses):
        return
    for row in (0, -1):
        number = int(poses.index[row])
        stamp = log.frame(number).timestamp if number < len(log) else np.inf
        if abs(stamp - poses.timestamp[row]) > SAME:  # not so where a driver's error left no stamp, NaN
            source = poses.about.source
            raise LogError(
                f"{path}: found poses of another recording ({source}), expected those of {recording}"
            )
        if not log.random_access:
            return  # to read all of it takes long


def seconds_since_beginning(log: Path, poses: Poses) -> FloatArray:
    """Times (n,) [s] of poses since the first frame of their recording, from which goals count.

    Raises:
        LogError, OSError: the poses begin later, and the recording cannot be read.
    """
    if not len(poses) or poses.index[0] == 0:
        return poses.timestamp - poses.timestamp[:1]
    with open_log(log, recover=True) as opened:
        first = next(iter(opened), None)
    if first is None:
        raise LogError(f"{log}: found no frame that can be read, expected the first one")
    return poses.timestamp - first.timestamp


def goal_file(log: Path) -> Path:
    """Where the goal of a recording's job is, if there is one."""
    return (log if log.is_dir() else log.parent) / FILE_NAME


def goal_columns(log: Path, poses: Poses, model: CuboidModel) -> dict[str, Any]:
    """Columns of the table about the goal in the recording's folder, if there is one."""
    path = goal_file(log)
    if not path.is_file():
        return {}
    try:
        goal = read_job_goal(path)
        found: dict[str, Any] = {"task": goal.task, "level": goal.level}
        if goal.task == "rearrange_dice":
            return found
        columns = best(poses)
        seconds = seconds_since_beginning(log, poses)
        rewards = goal.rewards(seconds, columns.position, columns.orientation, model)
    except (TaskError, LogError, OSError) as error:
        return {"goal_fault": reason(error)}
    return {**found, **totals(rewards, seconds)}


def totals(rewards: FloatArray, seconds: FloatArray) -> dict[str, float]:
    """Sum over control steps, mean and last of rewards (n,) at times (n,) [s]; each lasts until the next.

    Where the object was not seen the reward before holds, at the beginning the first one.
    """
    known = np.flatnonzero(~np.isnan(rewards))
    if not len(known):
        return {}
    held = rewards[known[np.maximum(np.searchsorted(known, np.arange(len(rewards)), side="right") - 1, 0)]]
    steps = np.diff(seconds)
    steps = STEPS_PER_SECOND * np.append(steps, np.median(steps) if len(steps) else 0.1)
    total = float(np.sum(held * steps))
    mean = total / float(steps.sum()) if steps.sum() > 0 else float(np.mean(held))
    return {"reward_total": total, "reward_mean": mean, "error_end": 0.0 - float(held[-1])}
