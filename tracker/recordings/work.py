"""What a worker does with one recording: everything it needs goes to it in plain values."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tracker.errors import TrackerError
from tracker.recordings.fingerprint import code
from tracker.recordings.recipe import Job, Options, Recipe
from tracker.recordings.summary import summary
from tracker.recordings.track import Tracked, run


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
    """What code and files the worker has to have: `agreed` of whoever hands out the task."""

    @property
    def job(self) -> Job:
        """The same, loaded.

        Raises:
            TrackerError: something is unknown or malformed, or is not what it was to who handed it out.
        """
        return Job(Path(self.log), Path(self.output), _recipe(self.options, self.agreed))


def agreed(recipe: Recipe) -> str:
    """Digits that are others for other code, libraries, object, colours or calibration."""
    return f"{code()} {recipe.digest}"


def track_task(task: Task) -> dict[str, Any]:
    """Track a recording and write its file of poses, or take the one that is there; see `described`.

    Raises:
        TrackerError, OSError: see `run`.
    """
    job = task.job
    job.output.parent.mkdir(parents=True, exist_ok=True)
    return described(job, run(job))


def described(job: Job, tracked: Tracked) -> dict[str, Any]:
    """`log`, `output`, `object`, and what `summary` tells."""
    about = {"log": str(job.log), "output": str(job.output), "object": job.recipe.model.name}
    return {**about, **summary(tracked)}


@functools.lru_cache(maxsize=2)
def _recipe(options: Options, expected: str) -> Recipe:
    recipe = Recipe.of(options)
    if agreed(recipe) != expected:
        raise TrackerError(
            f"{options.object}: found another version of the tracker, its libraries, the object, the colours "
            "or the calibration in this worker than where the work is handed out; expected the same"
        )
    return recipe
