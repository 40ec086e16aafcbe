"""Image data sets of trifinger_rl_datasets, `NAME.zarr/data.mdb`: their images and control steps.

`observations` (steps, n) is a nested dictionary, flattened in order of sorted keys; n identifies the task.
"""

from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tracker.checks import naming
from tracker.conventions import Array, FloatArray, Image
from tracker.errors import LogError
from tracker.files import on_error
from tracker.files.stores import LmdbFile, StoredArray
from tracker.logs.frame import MAX_CONFIDENCE, MAX_DISTANCE, NORM_TOLERANCE, LogFrame
from tracker.logs.log import MAX_CAMERAS, MAX_SIDE, MIN_SIDE, Source, check_same_size, default_names
from tracker.logs.pictures import decode, from_bayer, from_quadrants

STORE_FILE = "data.mdb"
"""The file of an image store."""

CAMERA_RATE = 10.0
"""Frame rate of the cameras [Hz]."""

CONTROL_RATE = 50.0
"""Rate of the policy's control steps [Hz], the rows of `obs_to_image_index`."""

_TASKS = {97: ("push", 3), 139: ("lift", 24)}
"""Task, and length of its goal, by the length of an observation: a position in push, keypoints in lift."""

_ACTION, _CAMERA = 9, 33
_IN_CAMERA = {"confidence": (0, 1), "delay": (1, 2), "orientation": (26, 30), "position": (30, 33)}
_IN_ROBOT = {"joints": (21, 30), "robot": (30, 31)}


class DatasetSource(Source):
    """The images of all episodes, one episode after the other.

    A frame's timestamp is that of the first control step that saw it: the store has no other times.
    """

    gaps = True

    def __init__(self, path: Path) -> None:
        super().__init__(path.parent if path.name == STORE_FILE else path)
        self.format = "image store of trifinger_rl_datasets"
        self.store = LmdbFile(self.path / STORE_FILE)
        with on_error(self.close):
            self._open()

    def _open(self) -> None:
        self._images = images = StoredArray(self.store, "images", str(self.path))
        where, attributes = f"{self.path}: images", images.attributes
        if not images.ragged:
            raise LogError(f"{where}: found numbers, expected encoded images")
        cameras = attributes.get("n_cameras", 3)
        if not isinstance(cameras, int) or not 1 <= cameras <= MAX_CAMERAS:
            raise LogError(f"{where}: n_cameras: found {str(cameras)[:60]}, expected 1 to {MAX_CAMERAS}")
        packing = attributes.get("compression", "image")
        if packing != "image":
            raise LogError(f"{where}: compression: found {str(packing)[:60]}, expected 'image'")
        self._reordered = bool(attributes.get("reorder_pixels", False))
        self.camera_names = default_names(cameras)
        shape = attributes.get("image_shape")
        sides = shape if isinstance(shape, list) else []
        valid = [isinstance(side, int) and MIN_SIDE <= side <= MAX_SIDE for side in sides]
        if valid != [True, True]:
            raise LogError(f"{where}: image_shape: found {str(shape)[:60]}, expected rows and columns")
        self.image_sizes = ((sides[1], sides[0]),) * cameras
        self.count, left = divmod(len(images), cameras)
        if left:
            raise LogError(f"{where}: found {len(images)}, expected a multiple of {cameras} cameras")
        steps = self._first_steps(cameras)
        if steps is None:
            self._stamps: FloatArray = np.arange(self.count) / CAMERA_RATE
            return
        self._stamps = steps / CONTROL_RATE
        ends = StoredArray.find(self.store, "episode_ends", str(self.path))
        if ends is not None:
            numbers, last = _checked_ends(ends, self.store, self.path)
            after = np.searchsorted(steps, numbers[numbers < last], side="right")
            self.episode_starts = tuple(sorted({0, *(int(start) for start in after if start < self.count)}))

    def read(self, index: int) -> LogFrame:
        """See Source."""
        cameras = len(self.camera_names)
        pixels = tuple(self._pixels(index, camera) for camera in range(cameras))
        images = tuple(from_bayer(one) if one.ndim == 2 else one for one in pixels)
        raw = pixels if all(one.ndim == 2 for one in pixels) else None
        stamps = np.full(cameras, self._stamps[index])
        return LogFrame(index, float(stamps[0]), stamps, images, None, None, raw)

    def close(self) -> None:
        """See Source."""
        self.store.close()

    def _pixels(self, index: int, camera: int) -> Image:
        """Return an image's raw Bayer pixels (H, W), or BGR (H, W, 3) if it has colours."""
        number = index * len(self.camera_names) + camera
        with naming(f"{self.where(index)}: image {number}", LogError):
            picture = decode(self._images[number], color=False)
            check_same_size(picture.shape[1::-1], self.image_sizes[camera])
            if picture.ndim == 3:
                return np.ascontiguousarray(picture[:, :, :3])
            return from_quadrants(picture) if self._reordered else picture

    def _first_steps(self, cameras: int) -> FloatArray | None:
        """Return (count,) the first control step that saw each frame; None if that is not stored.

        Frames that no step saw are interpolated evenly between those that were seen; before the first of
        these, steps are negative.
        """
        shown = StoredArray.find(self.store, "obs_to_image_index", str(self.path))
        if shown is None:
            return None
        images = shown.numbers(1, "iu").astype(np.int64)
        before, last = np.concatenate([[0], images[:-1]]), len(self._images) - cameras
        bad = (images < before) | (images > last) | (images % cameras > 0)
        if bad.any():
            k, valid = int(np.argmax(bad)), f"a multiple of {cameras} cameras"
            what = f"{self.path}: obs_to_image_index: step {k}: found {images[k]}"
            raise LogError(f"{what}, expected {valid} from {before[k]} to {last}")
        if not len(images):
            return None
        seen, at = np.unique(images // cameras, return_index=True)
        numbers = np.arange(self.count)
        period = CONTROL_RATE / CAMERA_RATE
        result: FloatArray = np.interp(numbers, seen, at)
        result += period * np.minimum(numbers - seen[0], 0) + period * np.maximum(numbers - seen[-1], 0)
        return result


class Episode(NamedTuple):
    """A part of a store that a single robot recorded without interruption."""

    number: int
    """Number of the episode, from 0."""
    robot: int | None
    """Number of the robot; None if the store does not have it."""
    steps: range
    """Control steps of the episode."""
    frames: range
    """Sets of images that the steps saw, except those that an earlier episode also saw."""


@dataclass(frozen=True, eq=False)
class StoreSteps:
    """The control steps of a store."""

    where: str
    """Name of the store in errors."""
    frame: Array
    """(n,) int64: number of the set of images that each step saw."""
    ends: Array
    """(e,) int64: last step of each episode."""
    frames: int
    """Number of sets of images in the store."""
    task: str | None
    """`push` or `lift`; None if there are no observations, or those of another task."""
    observed: dict[str, FloatArray]
    """Columns (n, k) by name: `robot`, `joints` [rad], and those of the stored pose: `position` [m],
    `orientation` (x, y, z, w), `confidence` and `delay` [s]; empty without a task."""

    def episodes(self) -> list[Episode]:
        """Return all episodes; LogError if one has several robots, or an invalid robot number.

        A set of images that two episodes saw belongs to the first.
        """
        found: list[Episode] = []
        for number, last in enumerate(self.ends.tolist()):
            first = found[-1].steps.stop if found else 0
            after = found[-1].frames.stop if found else 0
            own = [frame for frame in self.frame[first : last + 1].tolist() if frame >= after]
            frames = range(own[0], own[-1] + 1) if own else range(after, after)
            found.append(Episode(number, self._robot(number, first, last), range(first, last + 1), frames))
        return found

    def stored_with(self, frames: Array) -> tuple[Array, dict[str, Array] | None]:
        """Return the first step that saw each set of images or a later one, and the pose stored with it.

        The columns are those of `PoseColumns`; None if the store has no poses. Rows without a valid pose, and
        those of images that no step saw, are NaN.
        """
        steps = np.minimum(np.searchsorted(self.frame, frames), len(self.frame) - 1)
        if self.task is None:
            return steps, None
        position, orientation = self.observed["position"][steps], self.observed["orientation"][steps]
        confidence = self.observed["confidence"][steps, 0]
        length = np.linalg.norm(orientation, axis=1)
        near = np.abs(position).max(axis=1, initial=0) <= MAX_DISTANCE
        seen = self.frame[steps] == frames
        sure = (confidence > 0) & (confidence <= MAX_CONFIDENCE)
        usable = seen & near & (np.abs(length - 1) <= NORM_TOLERANCE) & sure
        orientation = orientation / np.where(usable, length, 1)[:, None]
        for column in (position, orientation, confidence):
            column[~usable] = np.nan
        values = {"position": position, "orientation": orientation, "confidence": confidence}
        return steps, {"has_pose": usable, **values}

    def _robot(self, number: int, first: int, last: int) -> int | None:
        if self.task is None:
            return None
        found = np.unique(self.observed["robot"][first : last + 1])
        if len(found) > 1 or not 0 <= found[0] < 1e6 or found[0] % 1:
            names = ", ".join(f"{value:g}" for value in found[:5])
            what = f"{self.where}: episode {number}: robot_id"
            raise LogError(f"{what}: found {names}, expected the number of one robot")
        return int(found[0])


def is_store(path: Path) -> bool:
    """Whether the path is an image store, or the file in it."""
    return path.name == STORE_FILE or (path / STORE_FILE).is_file()


def read_steps(path: Path) -> StoreSteps:
    """Return the control steps of a store; LogError if it is not a store, or is damaged or inconsistent."""
    # DatasetSource checks the stored numbers of images for consistency.
    with closing(DatasetSource(path)) as source:
        shown, ends = (
            StoredArray(source.store, name, str(path)) for name in ("obs_to_image_index", "episode_ends")
        )
        frame = shown.numbers(1).astype(np.int64) // len(source.camera_names)
        last, _ = _checked_ends(ends, source.store, path)
        task, observed = _observed(source.store, path, len(frame))
        return StoreSteps(str(path), frame, last, source.count, task, observed)


def _checked_ends(ends: StoredArray, store: LmdbFile, path: Path) -> tuple[Array, int]:
    """Return the last step of each episode, and of all; LogError if they do not increase, or exceed it."""
    numbers = ends.numbers(1, "iu").astype(np.int64)
    last = len(StoredArray(store, "obs_to_image_index", str(path))) - 1
    bad = (np.diff(numbers, prepend=-1) <= 0) | (numbers > last)
    if not len(numbers) or bad.any():
        found = f"{numbers[np.argmax(bad)]}" if len(numbers) else "none"
        raise LogError(f"{path}: episode_ends: found {found}, expected steps that increase, up to {last}")
    return numbers, last


def _observed(store: LmdbFile, path: Path, steps: int) -> tuple[str | None, dict[str, FloatArray]]:
    """Return the task and the columns of `StoreSteps.observed`."""
    array = StoredArray.find(store, "observations", str(path))
    if array is None or array.shape[-1] not in _TASKS:
        return None, {}
    task, goal = _TASKS[array.shape[-1]]
    if len(array) != steps:
        raise LogError(f"{path}: observations: found {len(array)} steps, expected {steps}")
    camera = goal + _ACTION
    robot = camera + _CAMERA + goal
    columns = {name: slice(camera + a, camera + b) for name, (a, b) in _IN_CAMERA.items()}
    columns |= {name: slice(robot + a, robot + b) for name, (a, b) in _IN_ROBOT.items()}
    rows = array.numbers(2, columns=np.r_[tuple(columns.values())]).astype(float)
    ends = np.cumsum([one.stop - one.start for one in columns.values()])
    return task, dict(zip(columns, np.split(rows, ends[:-1], axis=1), strict=True))
