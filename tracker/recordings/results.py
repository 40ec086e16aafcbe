"""What of a batch is done: a small file beside each file of poses.

    a/b.dat.poses.h5       the poses
    a/b.dat.summary.json   the line about them, and what they were made from
    a/b.dat.failed.json    instead of these: why there are none

These files are all that a batch remembers, so that any number of processes on any machines can add to it.
They hold no times and no names of machines: the same recordings give the same bytes.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from tracker.errors import reason
from tracker.files import read_bounded, write_whole
from tracker.recordings.names import SUFFIX
from tracker.recordings.recipe import Job
from tracker.recordings.rows import COLUMNS, goal_file, row
from tracker.recordings.track import run
from tracker.recordings.work import Task

MAX_FILE_SIZE = 100_000
"""Largest file [bytes] that is read; they have 2 kB."""


def summary_file(output: Path) -> Path:
    """Where the line about a file of poses is."""
    return output.with_name(output.name.removesuffix(SUFFIX) + ".summary.json")


def failure_file(output: Path) -> Path:
    """Where the reason is why there is no file of poses."""
    return output.with_name(output.name.removesuffix(SUFFIX) + ".failed.json")


def make_result(task: Task) -> dict[str, Any]:
    """Track a recording, and write the line about it or why it could not be; for a worker.

    Returns:
        `recording`, `frames` that were tracked now, `seconds` that took, `failure`: the reason or None.
    """
    output = Path(task.output)
    told: dict[str, Any] = {"recording": task.log, "frames": 0, "seconds": 0.0, "failure": None}
    try:
        output.parent.mkdir(parents=True, exist_ok=True)
        job = task.job
        tracked = run(job)
        about = output.stat()
        line = {"fingerprint": tracked.poses.about.fingerprint, "bytes": about.st_size, **row(job, tracked)}
        write_whole(summary_file(output), json.dumps(line, indent=1, allow_nan=False) + "\n")
        failure_file(output).unlink(missing_ok=True)
    except BlockingIOError as error:
        told["failure"] = reason(error)  # the other run will say how it went
    except Exception as error:  # whatever it is, the other recordings are to be done
        told["failure"] = reason(error) if str(error) else repr(error)
        keep_failure(task, told["failure"])
    else:
        told |= {"frames": tracked.new, "seconds": tracked.seconds}
    return told


def keep_failure(task: Task, why: str) -> None:
    """Write why there are no poses of a recording, if that can be written."""
    output = Path(task.output)
    try:
        output.parent.mkdir(parents=True, exist_ok=True)
        summary_file(output).unlink(missing_ok=True)
        content = {"recording": task.log, "reason": why}
        write_whole(failure_file(output), json.dumps(content, indent=1) + "\n")
    except OSError:
        pass  # a full disk, for instance; it is told anyway


def read_line(output: Path) -> dict[str, Any] | None:
    """The line about a file of poses, which is there as it was when that was written; None: it is not."""
    path = summary_file(output)
    line = _read(path)
    if line is None or not COLUMNS.keys() <= line.keys():
        return None
    try:
        poses, about = output.stat(), path.stat()
    except OSError:
        return None
    same = poses.st_size == line.get("bytes") and poses.st_mtime_ns <= about.st_mtime_ns
    return line if same else None


def read_failure(output: Path) -> str | None:
    """Why there are no poses, as far as that is known."""
    content = _read(failure_file(output))
    return None if content is None else str(content.get("reason"))


def is_done(job: Job, mark: str) -> bool:
    """Whether a recording's result is there, of this fingerprint; the poses are not opened for that."""
    line = read_line(job.output)
    return line is not None and line.get("fingerprint") == mark and not _goal_is_newer(job)


def _goal_is_newer(job: Job) -> bool:
    try:
        goal = goal_file(job.log).stat()
    except OSError:
        return False
    return goal.st_mtime_ns > summary_file(job.output).stat().st_mtime_ns


def _read(path: Path) -> dict[str, Any] | None:
    try:
        content = json.loads(read_bounded(path, MAX_FILE_SIZE))
    except (OSError, ValueError, RecursionError):
        return None
    return content if isinstance(content, dict) else None
