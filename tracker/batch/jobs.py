"""Jobs for HTCondor and Slurm: each tracks a share of the missing recordings.

Job descriptions are submitted from their own folder and use file names relative to it, so that no path except
Python's has to be quoted for a shell or a scheduler.
"""

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

import cv2

from tracker.batch.run import Batch, Task, read_asked, run_batch
from tracker.batch.workers import ONE_THREAD, engine
from tracker.errors import LogError, TrackerError
from tracker.files import write_whole

Scheduler = Literal["htcondor", "slurm"]

FOLDER = ".jobs"
"""Subfolder of the results for lists of recordings, job descriptions and job logs."""

RECORDINGS_A_JOB = 10
"""Usual number of recordings per job: enough that loading the program costs little in comparison."""

MOST_JOBS = 1000
"""Largest number of jobs, Slurm's default limit; beyond it, each job gets more recordings."""

_THREADS = " ".join(f"{name}={value}" for name, value in ONE_THREAD.items())

_PROGRAM = "import sys; sys.path[:] = filter(None, sys.path); from tracker.cli import main; main()"
"""Runs the command line without the current folder, where others may have put files, in `sys.path`."""

_HTCONDOR = f"""\
# Recordings that are missing, several a job. Made by `tracker batch run --htcondor`; to be submitted here.
executable = {{python}}
arguments = "-c '{_PROGRAM}' batch share {{name}}.json $(number)"
environment = "{_THREADS}"
getenv = NUMBA_CACHE_DIR
transfer_executable = false
should_transfer_files = no
log = logs/{{name}}.log
output = logs/{{name}}-$(number).out
error = logs/{{name}}-$(number).err
request_cpus = 1
request_memory = 1500
# Jobs that wait in the queue or run at once.
max_materialize = 200
# A job is begun again where its machine failed. 2: a recording could not be done, which that would not mend.
max_retries = 3
retry_until = ExitCode == 0 || ExitCode == 2
queue number from (
{{numbers}}
)
"""

_SLURM = f"""\
#!/bin/sh
# Recordings that are missing, several a job. Made by `tracker batch run --slurm`; to be submitted here.
#SBATCH --job-name=tracker
#SBATCH --array=0-{{last}}
#SBATCH --ntasks=1
#SBATCH --cpus-per-task=1
#SBATCH --mem=1500M
#SBATCH --requeue
#SBATCH --output=/dev/null
# Slurm would take a % in the path of this folder for a pattern.
exec >>"logs/{{name}}-$SLURM_ARRAY_TASK_ID.out" 2>&1
export {_THREADS}
list=$PWD/{{name}}.json
cd / || exit 1  # Python looks for modules in the present folder, in which others may have put files
{{python}} -m tracker batch share "$list" "$SLURM_ARRAY_TASK_ID"
code=$?
# 2: a recording could not be done, which another attempt would not mend.
if [ $code -ne 0 ] && [ $code -ne 2 ] && [ "${{{{SLURM_RESTART_COUNT:-0}}}}" -lt 3 ]; then
    scontrol requeue "${{{{SLURM_ARRAY_JOB_ID}}}}_$SLURM_ARRAY_TASK_ID"
fi
exit $code
"""


@dataclass(frozen=True)
class Description:
    """A job description to submit."""

    command: str
    """The scheduler's command that submits it."""
    path: Path
    """File to write it to; the list of recordings is beside it."""
    text: str
    list_text: str

    def write(self) -> None:
        """Write both files, and make the folder for the jobs' logs; OSError if that fails."""
        (self.path.parent / "logs").mkdir(parents=True, exist_ok=True)
        write_whole(self.path.with_suffix(".json"), self.list_text)
        write_whole(self.path, self.text)

    def submit(self) -> str:
        """Submit it and return the scheduler's output; TrackerError if the command is missing or fails.

        Jobs load compiled kernels from the same place as this process: beside the sources, or the user's
        NUMBA_CACHE_DIR. Nothing in the folder of results, to which others may write, is executed.
        """
        place, name = os.path.split(self.path)
        kernels = os.environ.get("NUMBA_CACHE_DIR")
        own = {"NUMBA_CACHE_DIR": os.path.abspath(kernels)} if kernels is not None else {}
        try:
            done = subprocess.run(
                [self.command, name], cwd=place, env={**os.environ, **own}, capture_output=True, text=True
            )
        except OSError as error:
            raise TrackerError(
                f"{self.command}: cannot be run: {error.strerror}; {self.path} is what it would be given"
            ) from error
        if done.returncode:
            raise TrackerError(f"{self.command} {self.path}: {done.stderr.strip() or done.stdout.strip()}")
        return done.stdout.strip()


def describe(batch: Batch, tasks: Sequence[Task], scheduler: Scheduler) -> Description:
    """Describe the jobs for some recordings; TrackerError if Python's path is not printable."""
    if not sys.executable.isprintable():
        raise TrackerError(f"{sys.executable!r}: found a line break or the like, expected a path without")
    each = max(RECORDINGS_A_JOB, -(-len(tasks) // MOST_JOBS))
    content: dict[str, Any] = {
        "options": batch.options.plain(),
        "agreed": tasks[0].agreed,
        "each": each,
        "recordings": [[task.log, os.path.relpath(task.output, batch.folder)] for task in tasks],
    }
    list_text = json.dumps(content, indent=0) + "\n"
    name = hashlib.sha256(list_text.encode()).hexdigest()[:12]
    path = Path(os.path.abspath(batch.folder)) / FOLDER / name
    count = -(-len(tasks) // each)
    command, suffix, text, python = {
        "slurm": ("sbatch", ".sh", _SLURM, shlex.quote(sys.executable)),
        "htcondor": ("condor_submit", ".sub", _HTCONDOR, sys.executable.replace("$", "$(DOLLAR)")),
    }[scheduler]
    numbers = "\n".join(f"    {number}" for number in range(count))
    text = text.format(name=name, last=count - 1, numbers=numbers, python=python)
    return Description(command, path.with_suffix(suffix), text, list_text)


def do_share(list_path: Path, number: int) -> int:
    """Track the unfinished recordings of one job's share of a list; return the number that failed."""
    batch, mark, each = read_asked(list_path, list_path.absolute().parent.parent)
    share = batch.work()[number * each : (number + 1) * each]
    if number < 0 or not share:
        raise LogError(f"{list_path}: found {-(-len(batch.pairs) // each)} jobs, expected {number} below")
    if share[0][0].agreed != mark:
        raise TrackerError(f"{list_path}: found a list of another version or other files, submit it again")
    cv2.setNumThreads(1)  # of OpenCV, which no environment variable sets
    return run_batch(share, engine(1), lambda _: None)
