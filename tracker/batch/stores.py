"""Image stores of several robots: each episode is tracked with the calibration of its robot."""

from __future__ import annotations

import dataclasses
import functools
import itertools
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

from tracker.batch.results import output_of_episode, outputs_of, recordings_of, summary_file
from tracker.batch.run import Batch, Report, Task, agreed, run_tasks, unfinished
from tracker.batch.store_tables import Tracked, write_store
from tracker.batch.workers import Engine
from tracker.calibration.files.folder import pattern_of, robots_in
from tracker.errors import CalibrationError, LogError, TrackerError, install
from tracker.logs.store_steps import Episode, is_store, read_steps
from tracker.recordings.recipe import Options, Recipe


class Planned(NamedTuple):
    """An episode to be tracked."""

    tracked: Tracked
    """What there will be."""
    task: Task
    recipe: Recipe
    """What the task loads."""


@dataclass(frozen=True)
class Retracking:
    """Stores, of each of them the episodes, and the folder of the results."""

    batch: Batch
    """Of the episodes, by the names of their tasks."""
    stores: Mapping[Path, Sequence[Planned]]

    @classmethod
    def of(
        cls, recordings: Sequence[str], folder: Path, options: Options, robot: str | None = None
    ) -> Retracking:
        """Plan the work; nothing is tracked yet.

        Args:
            recordings: paths and patterns of stores.
            folder: of the results.
            options: `calibration` names the folder of the robots' files; `start` and `stop` choose frames.
            robot: whose calibration is that of all episodes; None: that of each episode's own robot.

        Raises:
            LogError: a store is damaged, or does not tell the robots.
            CalibrationError: a robot has no calibration.
            TrackerError: a package is missing.
        """
        if find_spec("pyarrow") is None:
            raise TrackerError(f"tables of image stores need the package pyarrow: {install('cluster')}")
        options = options.absolute()
        known = robots_in(Path(options.calibration[0]))
        if robot is not None and robot not in known:
            raise CalibrationError(f"--robot: found {robot}, expected one of {', '.join(known)}")

        @functools.cache
        def recipe_of(robot: str) -> Recipe:
            return Recipe.of(dataclasses.replace(options, pattern=pattern_of(robot), start=0, stop=None))

        def planned(path: Path, episode: Episode) -> Planned:
            name = robot or _robot_of(path, episode, options, known)
            start, stop = episode.frames.start, episode.frames.stop
            recipe = dataclasses.replace(recipe_of(name), start=start, stop=stop)
            own = dataclasses.replace(options, pattern=pattern_of(name), start=start, stop=stop)
            output = output_of_episode(path, episode.number, Path(os.path.abspath(folder)))
            part = f"episode {episode.number}"
            task = Task(os.path.abspath(path), str(output), own, agreed(recipe), part)
            return Planned(Tracked(episode, name, output), task, recipe)

        paths = recordings_of(recordings, folder)
        outputs_of(paths, folder)  # which refuses one that is given twice
        stores = {path: [planned(path, episode) for episode in _episodes(path, options)] for path in paths}
        tasks = [one.task for episodes in stores.values() for one in episodes]
        pairs = tuple((task.name, os.path.relpath(task.output, folder)) for task in tasks)
        return cls(Batch(folder, options, pairs), stores)

    def run(self, begin: Callable[[], AbstractContextManager[Engine]], report: Report) -> int:
        """Do what is missing; the number of episodes that could not be done. See `run_batch`."""
        return run_tasks(self._missing(lambda: report(None)), begin, report)

    def write_tables(self) -> dict[str, dict[str, Any]]:
        """Write the tables of the stores of which all episodes are done; by store what its report says.

        Raises:
            LogError: a file of poses cannot be read, or a table not be written.
        """
        reports = {}
        for path, episodes in self.stores.items():
            tracked = [one.tracked for one in episodes]
            if all(summary_file(one.output).exists() for one in tracked):
                model, folder = episodes[0].recipe.model, tracked[0].output.parent
                reports[str(path)] = write_store(folder, path.name, read_steps(path), model, tracked)
        return reports

    def _missing(self, done: Callable[[], None]) -> Iterator[Task]:
        for one in itertools.chain.from_iterable(self.stores.values()):
            yield from unfinished([one.task], one.recipe, done)


def are_stores(recordings: Sequence[str], folder: Path) -> bool:
    """Whether there are recordings and all of them are image stores; LogError where only some are."""
    found = [(path, is_store(path)) for path in recordings_of(recordings, folder)]
    others = [path for path, store in found if not store]
    if others and len(others) < len(found):
        raise LogError(f"{others[0]}: found another recording beside image stores, expected stores alone")
    return not others


def _episodes(path: Path, options: Options) -> list[Episode]:
    """The episodes with images among the chosen frames, which are theirs."""
    stop = 2**62 if options.stop is None else options.stop
    chosen = [
        one._replace(frames=range(max(one.frames.start, options.start), min(one.frames.stop, stop)))
        for one in read_steps(path).episodes()
    ]
    found = [one for one in chosen if one.frames]
    if not found:
        raise LogError(f"{path}: found no episode with images, expected some")
    return found


def _robot_of(path: Path, episode: Episode, options: Options, known: Sequence[str]) -> str:
    if episode.robot is None:
        raise LogError(
            f"{path}: observations: found none with a robot_id, expected 97 numbers (push) or 139 (lift); "
            "--robot says which robot recorded it"
        )
    name = f"r{episode.robot}"
    if name not in known:
        raise CalibrationError(
            f"{path}: episode {episode.number}: found robot {name}, expected one with files in "
            f"{options.calibration[0]}: {', '.join(known)}; --robot takes one for all episodes"
        )
    return name
