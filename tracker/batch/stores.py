"""Tracks image stores of several robots, each episode with the calibration of its robot.

The results of a store are its poses per set of images and per control step, and a comparison:

    images.parquet   one row per set of images
    steps.parquet    one row per control step, with the pose in the images that it saw
    poses.zarr       arrays shaped like the stored ones: per control step; in `images` per set of images
    report.json      differences from the stored poses, by robot and by episode

Arrays are in zarr version 2, each a single uncompressed block: the same rows give the same bytes.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import json
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tracker.batch import results
from tracker.batch.run import Batch, Task, Work
from tracker.calibration.files import pattern_of, robots_in
from tracker.checks import optional
from tracker.conventions import Array
from tracker.errors import CalibrationError, LogError
from tracker.files import parquet_file, whole_file, write_whole, writing
from tracker.geometry import cuboid
from tracker.logs.datasets import CONTROL_RATE, Episode, StoreSteps, is_store, read_steps
from tracker.poses.columns import PoseColumns
from tracker.poses.file import read_poses
from tracker.poses.poses import Poses
from tracker.recordings.track import Options, Recipe
from tracker.summaries.against_stored import differences


class Planned(NamedTuple):
    """An episode to track."""

    episode: Episode
    robot: str
    """Robot whose calibration is used."""
    task: Task
    recipe: Recipe


@dataclass(frozen=True)
class Retracking(Batch):
    """Batch of all episodes of stores, named like their tasks."""

    stores: Mapping[Path, Sequence[Planned]]

    @classmethod
    def of(
        cls, recordings: Sequence[str], folder: Path, options: Options, robot: str | None = None
    ) -> Retracking:
        """Plan the work on stores, given as paths and patterns; nothing is tracked yet.

        The options' `calibration` names the folder with the robots' files; `start` and `stop` select frames.
        The calibration of `robot` is used for all episodes; None: that of each episode's robot.

        Raises:
            TrackerError: a store is damaged or does not state the robots, one of these has no calibration, a
                package is missing, or results would be inside of a store.
        """
        optional("pyarrow", "cluster", "a table of image stores")
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
            output = str(results.output_of_episode(path, episode.number, Path(os.path.abspath(folder))))
            task = Task(os.path.abspath(path), output, own, recipe.digest, f"episode {episode.number}")
            return Planned(episode, name, task, recipe)

        paths = results.recordings_of(recordings, folder)
        results.outputs_of(paths, folder)  # raises if a path is given twice
        for path in paths:
            if os.path.realpath(results.output_of_episode(path, 0, folder).parent) == os.path.realpath(path):
                raise LogError(f"{path}: found its results inside of it in {folder}; expected another folder")
        stores = {path: [planned(path, episode) for episode in _episodes(path, options)] for path in paths}
        tasks = [one.task for episodes in stores.values() for one in episodes]
        pairs = tuple((task.name, os.path.relpath(task.output, folder)) for task in tasks)
        return cls(folder, options, pairs, stores)

    def work(self) -> list[Work]:
        """Return one task per episode."""
        return [(one.task, one.recipe) for episodes in self.stores.values() for one in episodes]

    def write_tables(self) -> dict[str, dict[str, Any]]:
        """Write the tables of stores whose episodes are all done; return their reports by store.

        LogError if a file of poses cannot be read, or a table cannot be written.
        """
        reports = {}
        for path, episodes in self.stores.items():
            outputs = [Path(one.task.output) for one in episodes]
            if all(results.summary_file(output).exists() for output in outputs):
                reports[str(path)] = write_store(outputs[0].parent, path.name, read_steps(path), episodes)
        return reports


def are_stores(recordings: Sequence[str], folder: Path) -> bool:
    """Whether all recordings are image stores; LogError if only some are."""
    found = [(path, is_store(path)) for path in results.recordings_of(recordings, folder)]
    absent = [path for path, store in found if not store and (path.suffix == ".zarr" or not path.exists())]
    if absent:
        there = "no image store" if absent[0].exists() else "nothing"
        raise LogError(f"{absent[0]}: found {there} there, expected an image store")
    others = [path for path, store in found if not store]
    if others and len(others) < len(found):
        raise LogError(f"{others[0]}: found another recording beside image stores, expected stores alone")
    return not others


def _episodes(path: Path, options: Options) -> list[Episode]:
    """Return the episodes that have images among the selected frames, limited to these."""
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


ARRAYS: dict[str, tuple[tuple[int, ...], str]] = {
    "object_position": ((3,), "m, in the world"),
    "object_orientation": ((4,), "unit quaternion x, y, z, w"),
    "object_keypoints": (
        (8, 3),
        "corners [m]; corner i is on the + side of x, y, z where bit 0, 1, 2 of i is 0",
    ),
    "confidence": ((1,), "probability that the pose is within 5 mm and 5 degrees of the truth"),
    "covariance": ((6, 6), "of position and rotation along world axes [m, rad]"),
}
"""Row shape and description of each array of the zarr group; the first three are also in the data set."""

_ROWS = "one a control step; in the group images, one a set of images; NaN where there is no pose"


def write_store(folder: Path, source: str, steps: StoreSteps, tracked: Sequence[Planned]) -> dict[str, Any]:
    """Write all tables of a store to a folder, each atomically; return the report.

    `tracked` has the episodes in order, all with poses. LogError as for `Retracking.write_tables`.
    """
    compared: list[tuple[Planned, tuple[Poses, Array]]] = []
    model = tracked[0].recipe.model
    about = {"source": source, "object": model.name, "rows": _ROWS}
    about |= {name: text for name, (_, text) in ARRAYS.items()}
    with (
        writing(LogError, folder),
        _group(folder / results.ZARR, about) as group,
        parquet_file(folder / results.IMAGES) as add_images,
        parquet_file(folder / results.STEPS) as add_steps,
    ):
        images = group / "images"
        images.mkdir()
        _add_arrays(group, len(steps.frame))
        _add_arrays(images, steps.frames)
        for one in tracked:
            poses = read_poses(one.task.output)
            first, stored = steps.stored_with(poses.index)
            poses = dataclasses.replace(poses, recorded=None if stored is None else PoseColumns(**stored))
            by_image = _rows_of(poses, one.episode.frames)
            by_step = _rows_of(poses, steps.frame[one.episode.steps])
            its = poses.filtered
            corners = cuboid.keypoints(its.position, its.rotation, model.size)
            arrays = its.position, its.orientation, corners, its.confidence[:, None], its.covariance
            for name, array in zip(ARRAYS, arrays, strict=True):
                _put(images, one.episode.frames.start, name, _taken(array, by_image))
                _put(group, one.episode.steps.start, name, _taken(array, by_step))
            add_images(_table(_image_columns(poses, steps, first, one)))
            add_steps(_table(_step_columns(poses, steps, by_step, one)))
            if poses.recorded is not None and len(poses):
                compared.append((one, (poses, steps.observed["delay"][first, 0])))
        report = {
            "source": source,
            "object": model.name,
            "task": steps.task,
            "robots": {
                robot: differences([parts for one, parts in compared if one.robot == robot])
                for robot in sorted({one.robot for one, _ in compared})
            },
            "episodes": [
                {"episode": one.episode.number, "robot": one.robot, **differences([parts])}
                for one, parts in compared
            ],
        }
        write_whole(folder / results.REPORT, json.dumps(report, indent=1, allow_nan=False) + "\n")
    return report


def _rows_of(poses: Poses, frames: Sequence[int] | Array) -> Array:
    """Return (n,) indices into the poses for sets of images; -1 for a set that was not tracked."""
    rows = dict(zip(poses.index.tolist(), range(len(poses)), strict=True))
    return np.array([rows.get(frame, -1) for frame in frames], np.int64)


def _taken(array: Array, rows: Array) -> Array:
    """Return the given rows of an array; NaN for row -1."""
    taken = np.concatenate([array, np.full((1, *array.shape[1:]), np.nan)])[rows]
    taken[np.isnan(taken)] = np.nan  # the sign of a computed NaN depends on its array's place in memory
    return taken


def _image_columns(poses: Poses, steps: StoreSteps, first: Array, one: Planned) -> dict[str, Array]:
    unseen = steps.frame[first] != poses.index
    columns = _named(one, len(poses)) | {"first_step": np.ma.masked_array(first, unseen)} | poses.table()
    columns |= {f"{kind}_covariance": getattr(poses, kind).covariance for kind in ("measured", "filtered")}
    joints = steps.observed["joints"][first].T if steps.task else np.empty((0, len(poses)))
    joints = np.where(unseen, np.nan, joints)
    return columns | {f"robot_position_{k}_rad": column for k, column in enumerate(joints)}


def _step_columns(poses: Poses, steps: StoreSteps, rows: Array, one: Planned) -> dict[str, Array]:
    numbers = np.asarray(one.episode.steps)
    columns = _named(one, len(numbers)) | {"step": numbers, "timestamp_s": numbers / CONTROL_RATE}
    columns["frame"] = steps.frame[numbers]
    found = {name: column for name, column in poses.table().items() if name.startswith("filtered_")}
    found["filtered_covariance"] = poses.filtered.covariance
    return columns | {name: _taken(column, rows) for name, column in found.items()}


def _named(one: Planned, count: int) -> dict[str, Array]:
    return {"robot": np.full(count, one.robot), "episode": np.full(count, one.episode.number)}


def _table(columns: dict[str, Array]) -> Any:
    """Return columns as a table of pyarrow; rows that are arrays become lists."""
    pa = optional("pyarrow", None, "this")

    def cells(column: Array) -> Any:
        flat, size = pa.array(column.reshape(-1), from_pandas=True), math.prod(column.shape[1:])
        return flat if column.ndim == 1 else pa.FixedSizeListArray.from_arrays(flat, size)

    return pa.table({name: cells(column) for name, column in columns.items()})


@contextlib.contextmanager
def _group(path: Path, attributes: dict[str, Any]) -> Iterator[Path]:
    """Yield the folder of a new group; it replaces an older one if the `with` block does not raise."""
    with whole_file(path) as temporary:
        temporary.mkdir()
        (temporary / ".zattrs").write_text(json.dumps(attributes, indent=1) + "\n")
        yield temporary
        if path.is_dir():  # a folder cannot be renamed onto another
            os.replace(path, temporary.with_name("old"))


def _add_arrays(group: Path, count: int) -> None:
    """Add the arrays listed in ARRAYS with `count` rows of NaN, each as one block in row-major order."""
    (group / ".zgroup").write_text('{"zarr_format": 2}\n')
    for name, (row, _) in ARRAYS.items():
        shape = (count, *row)
        about = {"zarr_format": 2, "dtype": "<f4", "fill_value": "NaN", "order": "C", "shape": shape}
        about |= {"chunks": shape, "compressor": None, "filters": None}
        (group / name).mkdir()
        (group / name / ".zarray").write_text(json.dumps(about, indent=1) + "\n")
        np.full(shape, np.nan, "<f4").tofile(_block(group, name))


def _put(group: Path, first: int, name: str, rows: Array) -> None:
    """Write rows to an array, starting at row `first`."""
    with _block(group, name).open("r+b") as file:
        file.seek(4 * first * math.prod(ARRAYS[name][0]))
        file.write(rows.astype("<f4").tobytes())


def _block(group: Path, name: str) -> Path:
    return group / name / ".".join("0" * (1 + len(ARRAYS[name][0])))
