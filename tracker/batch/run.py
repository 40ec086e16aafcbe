"""Many recordings: what a worker does with one, which of them are done, and doing the others."""

from __future__ import annotations

import contextlib
import functools
import itertools
import json
import os
import re
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tracker.batch import results
from tracker.batch.workers import Engine
from tracker.errors import LogError, TrackerError, reason
from tracker.files import claimed, lock_of, read_bounded, write_whole
from tracker.recordings.recipe import Job, Options, Recipe, code, fingerprint
from tracker.recordings.track import Tracked, run
from tracker.summaries.remarks import remark_on_recording
from tracker.summaries.row import goal_file, row
from tracker.summaries.summary import summary


@dataclass(frozen=True)
class Task:
    """A recording for a worker, which may be a process on another machine."""

    log: str
    output: str
    options: Options
    agreed: str
    """What code and files the worker has to have: `agreed` of the process that hands out the task."""
    part: str = ""
    """Which part of the recording, in words; empty: all of it."""

    @property
    def name(self) -> str:
        """What it is called in reports."""
        return f"{self.log}: {self.part}" if self.part else self.log

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
    try:
        output.parent.mkdir(parents=True, exist_ok=True)
        job = task.job
        tracked = run(job)
        about = output.stat()
        line = {"fingerprint": tracked.poses.about.fingerprint, "bytes": about.st_size}
        line |= row(job, tracked, remark_on_recording(job, tracked.poses))
        write_whole(results.summary_file(output), json.dumps(line, indent=1, allow_nan=False) + "\n")
        results.failure_file(output).unlink(missing_ok=True)
    except Exception as error:  # whatever it is, the other recordings are to be done
        return _failed(task, error)
    return {"recording": task.name, "frames": tracked.new, "seconds": tracked.seconds, "failure": None}


def _failed(task: Task, error: Exception) -> dict[str, Any]:
    """What `make_result` returns of a recording that could not be done; the reason is kept in a file."""
    why, output = reason(error), Path(task.output)
    if not isinstance(error, BlockingIOError):  # of which the other run reports the outcome
        with contextlib.suppress(OSError):  # a full disk, for instance; the result holds the failure
            output.parent.mkdir(parents=True, exist_ok=True)
            results.summary_file(output).unlink(missing_ok=True)
            content = {"recording": task.name, "reason": why}
            write_whole(results.failure_file(output), json.dumps(content, indent=1) + "\n")
    return {"recording": task.name, "frames": 0, "seconds": 0.0, "failure": why}


@functools.lru_cache(maxsize=2)
def _recipe(options: Options, expected: str) -> Recipe:
    recipe = Recipe.of(options)
    if agreed(recipe) != expected:
        raise TrackerError(
            f"{options.object}: found another version of the tracker, its libraries, the object, the colours "
            "or the calibration in this worker than where the work is handed out; expected the same"
        )
    return recipe


MAX_LIST = 1 << 28
"""Largest list of recordings [bytes]."""

_LEFT = re.compile(r"(\..+?)\.(?:[a-z0-9_]{8}\.tmp|lock)", re.DOTALL)
"""What `tracker.files` calls files while they are written: temporary folders and locks."""

Report = Callable[[dict[str, Any] | None], None]
"""Takes what `make_result` returns of each finished recording; None: it was done before."""


@dataclass(frozen=True)
class Batch:
    """Recordings, what is looked for in them, and the folder of the results."""

    folder: Path
    options: Options
    pairs: tuple[tuple[str, str], ...]
    """Of each recording its path and that of its file of poses, which is relative to the folder."""

    @classmethod
    def of(cls, recordings: Sequence[str], folder: Path, options: Options) -> Batch:
        """A batch of paths and patterns, see `recordings_of`; LogError where a recording is given twice."""
        logs = results.recordings_of(recordings, folder)
        outputs = results.outputs_of(logs, Path())
        pairs = ((os.path.abspath(log), str(output)) for log, output in zip(logs, outputs, strict=True))
        return cls(folder, options.absolute(), tuple(pairs))

    def tasks(self, mark: str) -> list[Task]:
        """One for each recording; mark: see `Task.agreed`."""
        root = os.path.abspath(self.folder)
        return [Task(log, os.path.join(root, output), self.options, mark) for log, output in self.pairs]


def write_batch(batch: Batch) -> None:
    """Keep what was asked for; folders are made."""
    batch.folder.mkdir(parents=True, exist_ok=True)
    content = {"options": batch.options.plain(), "recordings": batch.pairs}
    write_whole(batch.folder / results.ASKED, json.dumps(content, indent=0) + "\n")


def read_asked(path: Path, folder: Path) -> tuple[Batch, str, int]:
    """The list in a file, which others may have written, for a folder of results.

    Returns:
        The batch, `Task.agreed`, and the number of recordings a job.

    Raises:
        LogError: there is none, or it is malformed.
    """
    try:
        content = json.loads(read_bounded(path, MAX_LIST))
        pairs = tuple((str(log), str(output)) for log, output in content["recordings"])
        for _, output in pairs:
            inside = not os.path.isabs(output) and os.pardir not in Path(output).parts
            if not inside or not output.endswith(results.SUFFIX):
                raise ValueError(f"found {output!r:.80} for a result, expected a path below the folder")
        batch = Batch(folder, Options.of_plain(content["options"]), pairs)
        return batch, str(content.get("agreed", "")), int(content.get("each", 1))
    except OSError as error:
        raise LogError(f"{path}: cannot be read, expected a list of recordings: {error.strerror}") from error
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError) as error:
        raise LogError(f"{path}: found no batch: {' '.join(str(error).split())}") from error


def read_batch(folder: Path) -> Batch:
    """What was asked for in a folder of results; LogError as for `read_asked`."""
    return read_asked(folder / results.ASKED, folder)[0]


@contextlib.contextmanager
def only_run(batch: Batch) -> Iterator[None]:
    """Nobody else hands out recordings of this folder of results until the `with` block ends.

    What killed runs and workers have left is removed. BlockingIOError where another run is at work.
    """
    batch.folder.mkdir(parents=True, exist_ok=True)
    with claimed(batch.folder / results.ASKED):
        _remove_leftovers(batch)
        try:
            yield
        finally:
            _remove_leftovers(batch)


def run_batch(batch: Batch, begin: Callable[[], AbstractContextManager[Engine]], report: Report) -> int:
    """Do what is missing; the number of recordings that could not be done. See `run_tasks`."""
    recipe = Recipe.of(batch.options)
    return run_tasks(unfinished(batch.tasks(agreed(recipe)), recipe, lambda: report(None)), begin, report)


def run_tasks(
    missing: Iterator[Task], begin: Callable[[], AbstractContextManager[Engine]], report: Report
) -> int:
    """Do some tasks; the number of those that could not be done.

    begin: makes the engine, if there is anything to do. report: takes the result of each recording.
    """
    failures = 0
    first = next(missing, None)
    if first is None:
        return 0
    with begin() as engine:
        for task, result in engine(make_result, itertools.chain([first], missing)):
            if isinstance(result, Exception):  # its worker is gone, and could not say so
                result = _failed(task, result)
            failures += result["failure"] is not None
            report(result)
    return failures


def unfinished(tasks: Sequence[Task], recipe: Recipe, done: Callable[[], None]) -> Iterator[Task]:
    """The tasks without a result that is whole and of the same; `done` is called for each of the others.

    Those without any come first: nobody waits until ten thousand others have been looked at.
    """
    some = []
    for task in tasks:
        if os.path.exists(results.summary_file(Path(task.output))):  # unlike Path's, of names too long, too
            some.append(task)
        else:
            yield task
    for task in some:
        if is_whole(task, recipe):
            done()
        else:
            yield task


def is_whole(task: Task, recipe: Recipe) -> bool:
    """Whether a recording's result is there, and of the same; the poses are not opened for that."""
    job = Job(Path(task.log), Path(task.output), recipe)
    try:
        mark, line = fingerprint(job), results.read_line(job.output)
        if line is None or line.get("fingerprint") != mark:
            return False
        scored = results.summary_file(job.output).stat().st_mtime_ns
    except OSError:
        return False
    try:
        return goal_file(job.log).stat().st_mtime_ns <= scored
    except OSError:
        return True  # there is no goal


def _remove_leftovers(batch: Batch) -> None:
    """Remove what killed runs were writing of this batch; what others are still writing stays.

    A user who gives `.` for the folder of results has other files in it, which may be hidden, too: only
    names that follow from those of the batch's own files are looked at.
    """
    own = {lock_of(batch.folder / name): batch.folder / name for name in results.OF_ALL}
    for _, output in batch.pairs:
        path = batch.folder / output
        beside = [path.with_name(name) for name in results.OF_STORE] if results.is_episode(path) else []
        beside += [path, results.summary_file(path), results.failure_file(path)]
        own |= {lock_of(one): one for one in beside}
    for folder in {lock.parent for lock in own}:
        with contextlib.suppress(OSError), os.scandir(folder) as entries:
            for entry in list(entries):
                found = _LEFT.fullmatch(entry.name)
                target = own.get(folder / f"{found[1]}.lock") if found else None
                if target is not None:
                    mine = target.name == results.ASKED  # which this run has claimed
                    with contextlib.suppress(OSError), contextlib.nullcontext() if mine else claimed(target):
                        shutil.rmtree(entry.path, ignore_errors=True)
