"""What a worker does with one recording: everything it needs goes to it in plain values."""

from __future__ import annotations

import functools
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tracker.batch.results import failure_file, summary_file
from tracker.errors import TrackerError, reason
from tracker.files import write_whole
from tracker.recordings.recipe import Job, Options, Recipe, code
from tracker.recordings.track import Tracked, run
from tracker.summaries.remarks import remark_on_recording
from tracker.summaries.row import row
from tracker.summaries.summary import summary


@dataclass(frozen=True)
class Task:
    """A recording for a worker, which may be a process on another machine."""

    log: str
    """The recording."""
    output: str
    """The file of poses."""
    options: Options
    """What is looked for and how."""
    agreed: str
    """What code and files the worker has to have: `agreed` of the process that hands out the task."""

    @property
    def job(self) -> Job:
        """The same, loaded; TrackerError where it is not what it was to who handed it out."""
        return Job(Path(self.log), Path(self.output), _recipe(self.options, self.agreed))


def agreed(recipe: Recipe) -> str:
    """Digits that are others for other code, libraries, object, colours or calibration."""
    return f"{code()} {recipe.digest}"


def track_task(task: Task) -> dict[str, Any]:
    """Track a recording and write its file of poses, or take the one that is there; see `described`."""
    job = task.job
    job.output.parent.mkdir(parents=True, exist_ok=True)
    return described(job, run(job))


def described(job: Job, tracked: Tracked) -> dict[str, Any]:
    """`log`, `output`, `object`, what `summary` tells, and `swapped`, see `remark_on_recording`."""
    about = {"log": str(job.log), "output": str(job.output), "object": job.recipe.model.name}
    return {**about, **summary(tracked), "swapped": remark_on_recording(job, tracked.poses)}


def make_result(task: Task) -> dict[str, Any]:
    """Track a recording, and write the line about it or why it could not be; for a worker.

    Returns:
        `recording`, `frames` that were tracked now, `seconds` that took, `failure`: the reason or None.
    """
    output = Path(task.output)
    result: dict[str, Any] = {"recording": task.log, "frames": 0, "seconds": 0.0, "failure": None}
    try:
        output.parent.mkdir(parents=True, exist_ok=True)
        job = task.job
        tracked = run(job)
        about = output.stat()
        line = {"fingerprint": tracked.poses.about.fingerprint, "bytes": about.st_size, **row(job, tracked)}
        write_whole(summary_file(output), json.dumps(line, indent=1, allow_nan=False) + "\n")
        failure_file(output).unlink(missing_ok=True)
    except BlockingIOError as error:
        result["failure"] = reason(error)  # the other run reports the outcome
    except Exception as error:  # whatever it is, the other recordings are to be done
        result["failure"] = reason(error) if str(error) else repr(error)
        keep_failure(task, result["failure"])
    else:
        result |= {"frames": tracked.new, "seconds": tracked.seconds}
    return result


def keep_failure(task: Task, why: str) -> None:
    """Write why there are no poses of a recording, if that can be written."""
    output = Path(task.output)
    try:
        output.parent.mkdir(parents=True, exist_ok=True)
        summary_file(output).unlink(missing_ok=True)
        content = {"recording": task.log, "reason": why}
        write_whole(failure_file(output), json.dumps(content, indent=1) + "\n")
    except OSError:
        pass  # a full disk, for instance; the result holds the failure


@functools.lru_cache(maxsize=2)
def _recipe(options: Options, expected: str) -> Recipe:
    recipe = Recipe.of(options)
    if agreed(recipe) != expected:
        raise TrackerError(
            f"{options.object}: found another version of the tracker, its libraries, the object, the colours "
            "or the calibration in this worker than where the work is handed out; expected the same"
        )
    return recipe
