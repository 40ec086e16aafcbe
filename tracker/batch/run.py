"""Runs a batch: defines a worker's task for one recording, finds the unfinished tasks and does them."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import itertools
import json
import os
import re
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tracker.batch import results
from tracker.batch.workers import Engine
from tracker.checks import path_of
from tracker.errors import LogError, TrackerError, message, reason
from tracker.files import claimed, lock_of, read_bounded, write_whole
from tracker.files.hdf5 import text_of
from tracker.recordings.track import Job, Options, Recipe, Tracked, fingerprint, run
from tracker.summaries.remarks import remark_on_recording
from tracker.summaries.summary import goal_file, row, summary


@dataclass(frozen=True)
class Task:
    """A recording to track by a worker, which may be a process on another machine."""

    log: str
    output: str
    options: Options
    agreed: str
    """Digest of the recipe that the worker must have, too: that of the process that makes the task."""
    part: str = ""
    """Description of the part of the recording to track; empty: all of it."""

    @property
    def name(self) -> str:
        """Name of the task in reports."""
        return f"{self.log}: {self.part}" if self.part else self.log

    @property
    def job(self) -> Job:
        """The job, with its files loaded; TrackerError if code or files differ from `agreed`."""
        return Job(Path(self.log), Path(self.output), _recipe(self.options, self.agreed))


def track_task(task: Task) -> dict[str, Any]:
    """Track a recording and write its file of poses, or reuse an existing one; return it `described`."""
    job = task.job
    job.output.parent.mkdir(parents=True, exist_ok=True)
    return described(job, run(job))


def described(job: Job, tracked: Tracked) -> dict[str, Any]:
    """Return `log`, `output`, `object`, the fields of `summary`, and `warning`; see `remark_on_recording`."""
    about = {"log": str(job.log), "output": str(job.output), "object": job.recipe.model.name}
    return {**about, **summary(tracked), "warning": remark_on_recording(job, tracked.poses)}


def make_result(task: Task) -> dict[str, Any]:
    """Track a recording and write its table row, or the reason for a failure; called by a worker.

    Return `recording`; `frames` tracked by this call; `failure`, a reason or None.
    """
    output = Path(task.output)
    try:
        output.parent.mkdir(parents=True, exist_ok=True)
        if task.part:  # the tables of its store are of the result that this one replaces
            results.remove_tables(output.parent)
        job = task.job
        tracked = run(job)
        mark, about = tracked.poses.about.fingerprint, output.stat()
        line = {"fingerprint": mark, "bytes": about.st_size, "goal": _goal_of(job.log), "agreed": task.agreed}
        line |= row(job, tracked, remark_on_recording(job, tracked.poses))
        _write(results.summary_file(output), line)
        # With the poses' time: if the clock has been set back, its own would be earlier, as of older poses.
        os.utime(results.summary_file(output), ns=(about.st_atime_ns, about.st_mtime_ns))
        results.failure_file(output).unlink(missing_ok=True)
    except Exception as error:  # any error: the other recordings must still be done
        return _failed(task, error)
    return {"recording": task.name, "frames": tracked.new, "failure": None}


def _failed(task: Task, error: Exception) -> dict[str, Any]:
    """Write the reason for a failure to a file, and return the result for `make_result`."""
    why, output = reason(error), Path(task.output)
    if not isinstance(error, BlockingIOError):  # another run is tracking it, and reports the outcome
        with contextlib.suppress(OSError):  # for instance a full disk; the result returned has the reason
            output.parent.mkdir(parents=True, exist_ok=True)
            results.summary_file(output).unlink(missing_ok=True)
            _write(results.failure_file(output), {"recording": task.name, "reason": why})
    return {"recording": task.name, "frames": 0, "failure": why}


def _write(path: Path, content: dict[str, Any]) -> None:
    """Write a small file; it is claimed meanwhile, so that no other run removes the temporary one."""
    with claimed(path):
        write_whole(path, json.dumps(content, indent=1, allow_nan=False) + "\n")


@functools.lru_cache(maxsize=2)
def _recipe(options: Options, expected: str) -> Recipe:
    recipe = Recipe.of(options)
    if recipe.digest != expected:
        raise TrackerError(
            f"{options.object}: found another version of the tracker, its libraries, the object, the colours "
            "or the calibration in this worker than where the work is handed out; expected the same"
        )
    return recipe


MAX_LIST = 1 << 28
"""Largest list of recordings [bytes]."""

_LEFT = re.compile(r"(\..+?)\.(?:[a-z0-9_]{8}\.tmp|lock)", re.DOTALL)
"""Names of temporary folders and locks that `tracker.files` makes while files are written."""

Work = tuple[Task, Recipe]
"""A task, and the options of it with their files loaded."""

Report = Callable[[dict[str, Any] | None], None]
"""Callback for each recording's result from `make_result`; None: it was done before."""


@dataclass(frozen=True)
class Batch:
    """Recordings, the options for tracking them, and the folder of results."""

    folder: Path
    options: Options
    pairs: tuple[tuple[str, str], ...]
    """Path of each recording, and of its file of poses relative to the folder."""

    @classmethod
    def of(cls, recordings: Sequence[str], folder: Path, options: Options) -> Batch:
        """Make a batch from paths and patterns, see `recordings_of`; LogError if one is given twice."""
        logs = results.recordings_of(recordings, folder)
        outputs = results.outputs_of(logs, Path())
        pairs = ((os.path.abspath(log), str(output)) for log, output in zip(logs, outputs, strict=True))
        return cls(folder, options.absolute(), tuple(pairs))

    def work(self) -> list[Work]:
        """Return one task per recording; TrackerError if files that the options name cannot be loaded."""
        recipe, root = Recipe.of(self.options), os.path.abspath(self.folder)
        outputs = ((log, os.path.join(root, output)) for log, output in self.pairs)
        return [(Task(log, output, self.options, recipe.digest), recipe) for log, output in outputs]


def read_asked(path: Path, folder: Path) -> tuple[Batch, str, int]:
    """Return the batch, `Task.agreed` and recordings per job of a list, which is not trusted.

    LogError if there is no such file, or it is malformed.
    """
    try:
        content = json.loads(read_bounded(path, MAX_LIST))
        pairs = tuple((str(log), str(output)) for log, output in content["recordings"])
        for log, output in pairs:
            inside = not os.path.isabs(output) and os.pardir not in Path(output).parts
            os.fsencode(path_of(log + output, f"{path}: recordings", LogError))
            if not inside or not output.endswith(results.SUFFIX):
                raise ValueError(f"found {output!r:.80} for a result, expected a path below the folder")
        batch = Batch(folder, Options.of_plain(content["options"]), pairs)
        each = int(content.get("each", 1))
        if each < 1:
            raise ValueError(f"found {each} recordings for each job, expected 1 or more")
        return batch, str(content.get("agreed", "")), each
    except OSError as error:
        raise LogError(f"{path}: cannot be read, expected a list of recordings: {error.strerror}") from error
    except (ValueError, LookupError, TypeError, AttributeError, ArithmeticError, RecursionError) as error:
        raise LogError(f"{path}: found no batch: {message(error)}") from error


def read_batch(folder: Path) -> Batch:
    """Read the batch of a folder of results; LogError as for `read_asked`."""
    return read_asked(folder / results.ASKED, folder)[0]


@contextlib.contextmanager
def only_run(batch: Batch, work: Sequence[Work]) -> Iterator[None]:
    """Make this the only run with a folder of results until the `with` block ends; write what was asked for.

    work: the batch's. Leftovers of killed runs and workers are removed, and so are table rows of other
    options. BlockingIOError if another run is active, LogError if the folder holds other files with the names
    of a batch's own, or if results of other recordings or objects would be replaced.
    """
    batch.folder.mkdir(parents=True, exist_ok=True)
    tasks = [task for task, _ in work]
    content = {"options": batch.options.plain(), "recordings": batch.pairs}
    with claimed(batch.folder / results.ASKED):
        lines = [results.read_line(Path(task.output)) or {} for task in tasks]
        for (task, recipe), line in zip(work, lines, strict=True):
            _refuse_other_object(Path(task.output), line, recipe.model.name)
        if (batch.folder / results.ASKED).exists():
            _refuse_results_of_others(batch, tasks, lines, read_batch(batch.folder))
            for task, line in zip(tasks, lines, strict=True):
                # Rows of other options, files or code count as done until they are replaced.
                if line and line.get("agreed") != task.agreed:
                    results.summary_file(Path(task.output)).unlink(missing_ok=True)
        elif others := [name for name in _beside_poses(batch) if os.path.exists(batch.folder / name)]:
            raise LogError(f"{batch.folder}: found {others[0]}, but no batch; expected another folder")
        _remove_leftovers(batch)
        try:
            write_whole(batch.folder / results.ASKED, json.dumps(content, indent=0) + "\n")
            yield
        finally:
            _remove_leftovers(batch)


def run_batch(work: Iterable[Work], engine: AbstractContextManager[Engine], report: Report) -> int:
    """Do the unfinished tasks; return the number that failed.

    engine: begun only if there are tasks. report: takes the result of each recording.
    """
    failures, missing = 0, unfinished(work, lambda: report(None))
    first = next(missing, None)
    if first is None:
        return 0
    with engine as each:
        for task, result in each(make_result, itertools.chain([first], missing)):
            if isinstance(result, Exception):  # the worker ended before it could report it
                result = _failed(task, result)
            failures += result["failure"] is not None
            report(result)
    return failures


def unfinished(work: Iterable[Work], done: Callable[[], None]) -> Iterator[Task]:
    """Yield the tasks without a complete, matching result; call `done` for each of the others.

    Tasks without any result come first, so that work starts before thousands of results are checked.
    """
    some = []
    for task, recipe in work:
        if os.path.exists(results.summary_file(Path(task.output))):  # Path.exists raises for too long names
            some.append((task, recipe))
        else:
            yield task
    for task, recipe in some:
        if is_whole(task, recipe):
            done()
        else:
            yield task


def forget(tasks: Iterable[Task]) -> None:
    """Remove rows and reasons of tasks that jobs will do again: until they are replaced, they would count."""
    for output in (Path(task.output) for task in tasks):
        for path in (results.summary_file(output), results.failure_file(output)):
            with contextlib.suppress(OSError):  # there is none, or its name is too long
                path.unlink()


def is_whole(task: Task, recipe: Recipe) -> bool:
    """Whether a recording has a matching result, also of its goal; the poses are not opened."""
    job = Job(Path(task.log), Path(task.output), recipe)
    with contextlib.suppress(OSError):
        mark, line = fingerprint(job), results.read_line(job.output)
        return line is not None and (line.get("fingerprint"), line.get("goal")) == (mark, _goal_of(job.log))
    return False


def _goal_of(log: Path) -> str | None:
    """Return a hash of the goal beside a recording; None if there is none, or it cannot be read."""
    with contextlib.suppress(OSError):
        return hashlib.sha256(read_bounded(goal_file(log), MAX_LIST)).hexdigest()
    return None


def _refuse_results_of_others(
    batch: Batch, tasks: Iterable[Task], lines: Iterable[Mapping[str, Any]], before: Batch
) -> None:
    """Raise LogError if a recording has the relative path of another one, and would replace its result.

    The last command's recordings are those of `before`; table rows name those of earlier ones.
    """
    known = {output: log for log, output in before.pairs}
    for task, line, (log, output) in zip(tasks, lines, batch.pairs, strict=True):
        other = (known.get(output) or line.get("recording") or log).removesuffix(f": {task.part}")
        there = other != task.log and all(map(os.path.exists, (other, task.log, task.output)))
        if there and not os.path.samefile(other, task.log):  # nor is it one that was moved
            found = f"found the result of {other} under the same name"
            raise LogError(f"{task.log}: {found} in {batch.folder}, expected another folder")


def _refuse_other_object(output: Path, line: Mapping[str, Any], name: str) -> None:
    """Raise LogError if poses of another object would be replaced, given their row of the table, if any."""
    its = line.get("object")
    if its is None and output.exists():
        its = text_of(output, "object")
    if its not in (None, name):
        raise LogError(f"{output}: found poses of {its}, expected those of {name}, or another folder")


def _beside_poses(batch: Batch) -> Iterator[str]:
    """Yield the names, relative to the folder, of all files that a run may write, except those of poses."""
    yield from results.OF_ALL
    for _, output in batch.pairs:
        path = Path(output)
        beside = map(path.with_name, results.OF_STORE if path.name.startswith(results.EPISODE) else ())
        yield from map(str, (results.summary_file(path), results.failure_file(path), *beside))


def _remove_leftovers(batch: Batch) -> None:
    """Remove temporary files that killed runs of this batch left behind; files still being written stay.

    If the folder of results is `.`, it may contain other files, even hidden ones, so only names derived from
    the batch's own files are considered.
    """
    names = itertools.chain(_beside_poses(batch), (output for _, output in batch.pairs))
    own = {lock_of(path): path for path in map(batch.folder.joinpath, names)}
    for folder in {lock.parent for lock in own}:
        with contextlib.suppress(OSError), os.scandir(folder) as entries:
            for entry in list(entries):
                found = _LEFT.fullmatch(entry.name)
                target = own.get(folder / f"{found[1]}.lock") if found else None
                if target is not None:
                    mine = target.name == results.ASKED  # claimed by this run itself
                    with contextlib.suppress(OSError), contextlib.nullcontext() if mine else claimed(target):
                        shutil.rmtree(entry.path, ignore_errors=True)
