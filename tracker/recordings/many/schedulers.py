"""Descriptions of a batch for HTCondor and for Slurm: one for all recordings that are missing."""

from __future__ import annotations

import functools
import hashlib
import json
import os
import shlex
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from tracker.errors import LogError, TrackerError
from tracker.files import read_bounded, write_whole
from tracker.processes import python_command
from tracker.recordings.fingerprint import fingerprint
from tracker.recordings.many.batch import MAX_LIST, Batch
from tracker.recordings.many.engine import ONE_THREAD, Here, alone
from tracker.recordings.many.results import is_done
from tracker.recordings.many.work import Task, agreed, make_result
from tracker.recordings.recipe import Job, Options, Recipe

Scheduler = Literal["htcondor", "slurm"]

FOLDER = ".jobs"
"""In the folder of results: lists of recordings, descriptions and logs of jobs, compiled kernels."""

RECORDINGS_A_JOB = 10
"""So many, that loading costs little; …"""

MOST_JOBS = 1000
"""… and more where there would be more jobs than this: what Slurm takes at once unless told otherwise."""

AT_ONCE = 200
"""Jobs that wait in HTCondor's queue or run at once."""

RETRIES = 3
"""How often a job is begun again whose machine failed."""

MEMORY_MB = 1500


@dataclass(frozen=True)
class Description:
    """What is submitted."""

    scheduler: Scheduler
    path: Path
    """Where it is written."""
    text: str
    """Its content."""
    list_path: Path
    """The list of recordings, …"""
    list_text: str
    """… and its content."""

    def write(self) -> None:
        """Write both, and make the folders that jobs write to.

        Raises:
            OSError: they cannot be written.
        """
        (self.path.parent / "logs").mkdir(parents=True, exist_ok=True)
        write_whole(self.list_path, self.list_text)
        write_whole(self.path, self.text)

    def submit(self) -> str:
        """Submit it; what the scheduler says.

        Raises:
            TrackerError: its command is missing, or refuses.
        """
        command = {"htcondor": "condor_submit", "slurm": "sbatch"}[self.scheduler]
        try:
            done = subprocess.run([command, str(self.path)], capture_output=True, text=True, check=False)
        except OSError as error:
            raise TrackerError(
                f"{command}: cannot be run: {error.strerror}; {self.path} is what it would be given"
            ) from error
        if done.returncode:
            raise TrackerError(f"{command} {self.path}: {done.stderr.strip() or done.stdout.strip()}")
        return done.stdout.strip()


def describe(batch: Batch, tasks: Sequence[Task], scheduler: Scheduler) -> Description:
    """The description of jobs for some recordings, at least one."""
    folder = Path(os.path.abspath(batch.folder)) / FOLDER
    each = max(RECORDINGS_A_JOB, -(-len(tasks) // MOST_JOBS))
    content: dict[str, Any] = {
        "options": batch.options.plain(),
        "agreed": tasks[0].agreed,
        "each": each,
        "tasks": [[task.log, task.output] for task in tasks],
    }
    list_text = json.dumps(content, indent=0) + "\n"
    name = hashlib.sha256(list_text.encode()).hexdigest()[:12]
    list_path = folder / f"{name}.json"
    count = -(-len(tasks) // each)
    make = _htcondor if scheduler == "htcondor" else _slurm
    suffix = "sub" if scheduler == "htcondor" else "sh"
    text = make(folder, list_path, count)
    return Description(scheduler, folder / f"{name}.{suffix}", text, list_path, list_text)


def compile_kernels(folder: Path) -> None:
    """Compile into the folder that jobs take kernels from; on another kind of processor they add theirs.

    Raises:
        TrackerError: that fails.
    """
    command = python_command("from tracker.warm_up import warm_up; warm_up()")
    environment = {**os.environ, **_environment(Path(os.path.abspath(folder)) / FOLDER)}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        raise TrackerError(f"kernels cannot be compiled: {done.stderr.strip()[-300:]}")


def work(list_path: Path, number: int) -> int:
    """Do one job's share of a list, but for what is done; the number of recordings that could not be done.

    Raises:
        LogError: the list cannot be read, or there is no such job.
        TrackerError: an object, colours or a calibration is unknown or malformed.
    """
    try:
        content = json.loads(read_bounded(list_path, MAX_LIST))
        options, mark = Options.of_plain(content["options"]), str(content["agreed"])
        each, pairs = int(content["each"]), [(str(log), str(output)) for log, output in content["tasks"]]
    except OSError as error:
        raise LogError(f"{list_path}: cannot be read: {error.strerror}") from error
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError) as error:
        raise LogError(f"{list_path}: found no list of recordings: {error}") from error
    share = pairs[number * each : (number + 1) * each]
    if number < 0 or not share:
        raise LogError(f"{list_path}: found {-(-len(pairs) // each)} jobs, expected {number} below")
    recipe = Recipe.of(options)
    if agreed(recipe) != mark:
        raise TrackerError(f"{list_path}: found a list of another version or other files, submit it again")
    tasks = [Task(log, output, options, mark) for log, output in share]
    missing = [task for task in tasks if not _is_done(task, recipe)]
    results = [result for _, result in Here().each(functools.partial(alone, make_result), missing)]
    return sum(isinstance(result, Exception) or result["failure"] is not None for result in results)


def _is_done(task: Task, recipe: Recipe) -> bool:
    job = Job(Path(task.log), Path(task.output), recipe)
    try:
        return is_done(job, fingerprint(job))
    except OSError:
        return False


def _environment(folder: Path) -> dict[str, str]:
    return {**ONE_THREAD, "NUMBA_CACHE_DIR": str(folder / "kernels")}


def _htcondor(folder: Path, list_path: Path, count: int) -> str:
    """A job fails for its recordings' sake with a code of its own, for which it is not begun again."""
    variables = " ".join(f"{name}={_condor_quoted(value)}" for name, value in _environment(folder).items())
    arguments = " ".join(
        _condor_quoted(argument) for argument in ("-m", "tracker", "batch", "work", str(list_path))
    )
    logs = folder / "logs" / list_path.stem
    numbers = "\n".join(f"    {number}" for number in range(count))
    return f"""# Recordings that are missing, several a job. Made by `tracker batch --htcondor`.
executable = {sys.executable}
arguments = "{arguments} $(number)"
environment = "{variables}"
transfer_executable = false
should_transfer_files = no
initialdir = {folder}
log = {logs}.log
output = {logs}-$(number).out
error = {logs}-$(number).err
request_cpus = 1
request_memory = {MEMORY_MB}
max_materialize = {AT_ONCE}
max_retries = {RETRIES}
retry_until = ExitCode == 0 || ExitCode == 2
queue number from (
{numbers}
)
"""


def _slurm(folder: Path, list_path: Path, count: int) -> str:
    command = shlex.join([sys.executable, "-m", "tracker", "batch", "work", str(list_path)])
    variables = "\n".join(
        f"export {name}={shlex.quote(value)}" for name, value in _environment(folder).items()
    )
    return f"""#!/bin/sh
# Recordings that are missing, several a job. Made by `tracker batch --slurm`.
#SBATCH --job-name=tracker
#SBATCH --array=0-{count - 1}
#SBATCH --ntasks=1
#SBATCH --cpus-per-task=1
#SBATCH --mem={MEMORY_MB}M
#SBATCH --requeue
#SBATCH --open-mode=append
#SBATCH --output={_slurm_quoted(f"{folder}/logs/{list_path.stem}-")}%a.out
{variables}
# Python looks for modules in the present folder first: this one is nobody's but the batch's.
cd {shlex.quote(str(folder))} || exit 1
{command} "$SLURM_ARRAY_TASK_ID"
code=$?
# 2: a recording could not be done, which another attempt would not mend.
if [ $code -ne 0 ] && [ $code -ne 2 ] && [ "${{SLURM_RESTART_COUNT:-0}}" -lt {RETRIES} ]; then
    scontrol requeue "${{SLURM_ARRAY_JOB_ID}}_$SLURM_ARRAY_TASK_ID"
fi
exit $code
"""


def _slurm_quoted(path: str) -> str:
    """As a directive wants a path, in which % begins a pattern."""
    return '"' + path.replace("%", "%%").replace('"', '\\"') + '"'


def _condor_quoted(text: str) -> str:
    """As HTCondor's new syntax of arguments and environments wants it, within its double quotes."""
    return "'" + text.replace("'", "''").replace('"', '""') + "'"
