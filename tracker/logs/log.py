"""A recording: the interface of all formats, and access to frames in order or by number."""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from bisect import bisect_right
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from copy import copy
from itertools import islice, starmap
from pathlib import Path
from typing import TypeVar, overload

import numpy as np

from tracker.calibration.rig import CameraRig
from tracker.errors import LogError
from tracker.geometry.camera import check_name
from tracker.logs.frame import LogFrame, StampOrder, with_stamps

Item = TypeVar("Item")


def default_names(count: int) -> tuple[str, ...]:
    """Return the names of `count` cameras for a recording that does not state them; 3 as on the platform."""
    return tuple(f"camera{k}" for k in ((60, 180, 300) if count == 3 else range(count)))


MIN_SIDE, MAX_SIDE = 8, 4096
"""Smallest and largest valid width and height of an image [px]."""

MAX_CAMERAS = 16
"""Largest valid number of cameras of a recording."""


def check_sides(width: int, height: int, where: str = "") -> None:
    """Raise LogError, which begins with `where`, for images of an invalid size."""
    if not (MIN_SIDE <= width <= MAX_SIDE and MIN_SIDE <= height <= MAX_SIDE):
        raise LogError(f"{where}found {width}×{height} px, expected {MIN_SIDE} to {MAX_SIDE}")


def check_same_size(found: tuple[int, ...], size: tuple[int, int], where: str = "") -> None:
    """Raise LogError, which begins with `where`, if (width, height) differs from the camera's first image."""
    if found != size:
        raise LogError(f"{where}found {found[0]}×{found[1]} px, expected {size[0]}×{size[1]} as before it")


Progress = Callable[[int], None]
"""Callback that takes the number of frames done since the last call."""

Settings = Mapping[str, str | int | float | bool]
"""Camera settings such as exposure, gain and white balance, by the manufacturer's names."""


def evenly(items: Sequence[Item], most: int) -> list[Item]:
    """Return up to `most` of the items, evenly spaced."""
    places = np.linspace(0, len(items) - 1, min(most, len(items)))
    return [items[round(place)] for place in places.tolist()]


class Source(ABC):
    """Reads frames of one recording. Every fault of the recording raises a LogError."""

    format: str
    """Description of the format."""
    camera_names: tuple[str, ...]
    """Names of the cameras, in order."""
    image_sizes: tuple[tuple[int, int], ...] = ()
    """(width, height) [px] of each camera's images; empty if there is no frame."""
    count: int
    """Number of frames that the file plausibly holds."""
    missing: int = 0
    """Number of further frames that the file states, but is too short to hold."""
    sequential: bool = False
    """Whether reading a frame requires reading all frames before it."""
    gaps: bool = False
    """Whether any time may pass between two frames."""
    episode_starts: tuple[int, ...] = (0,)
    """Numbers of the frames that start an episode, unrelated to the frames before."""
    opening_fault: str | None = None
    """Fault that shows on opening, but leaves frames to recover."""
    unfinished: bool = False
    """Whether that fault is only a killed writer's: all frames that are left are whole."""

    def __init__(self, path: Path) -> None:
        self.path = path

    @abstractmethod
    def read(self, index: int) -> LogFrame:
        """Read the frame with this number, 0 ≤ index < count; LogError if it is damaged."""

    def check_end(self) -> None:  # noqa: B027 - most formats have no end to check
        """Check the file's end once the last frame has been read; LogError if it is wrong."""

    def rig(self) -> CameraRig | None:
        """Return the cameras' calibration, or None if there is none; TrackerError if it is malformed."""
        return rig_beside(Path(os.path.abspath(self.path)).parent, self.camera_names)

    def settings(self) -> dict[str, Settings]:
        """Return the recorded camera settings by camera name; LogError if they are malformed."""
        return {}

    def close(self) -> None:  # noqa: B027 - folders have nothing open
        """Close all open files."""

    def where(self, index: int) -> str:
        """Return the name of a frame in errors."""
        return f"{self.path}: frame {index}"


def rig_beside(folder: Path, names: tuple[str, ...]) -> CameraRig | None:
    """Load the calibration in the folder; None if there is none, TrackerError if it is faulty or incomplete.

    Files are camera60.yml or camera_calib_60.yml for each camera, camera_left.yml or left.yml for `left`.
    """
    files: dict[str, Path] = {}
    for name in names:
        stems = (name, f"camera_{name}", f"camera_calib_{name.removeprefix('camera').lstrip('_')}")
        options = [folder / f"{stem}{suffix}" for stem in stems for suffix in (".yml", ".yaml")]
        if found := [file for file in options if file.is_file()]:
            files[name] = found[0]
    if not files:
        return None
    if missing := [name for name in names if name not in files]:
        there = ", ".join(file.name for file in files.values())
        lacking = f"no calibration of {', '.join(missing)}; expected {missing[0]}.yml, too"
        raise LogError(f"{folder}: found {there}, but {lacking}")
    rig = CameraRig.load(list(files.values()))
    for (name, file), camera in zip(files.items(), rig, strict=True):
        if camera.name != name:
            raise LogError(f"{file}: camera_name: found {camera.name}, expected {name}")
    return rig


class Log(AbstractContextManager["Log"]):
    """Frames of a recording. A context manager; iterating starts at the first frame each time.

    `log[3]` is a frame, `log[100:200]` a part of the recording, read as you iterate. Only one frame is in
    memory at a time, or three with `recover`.

    With `recover`, iteration skips damaged frames, and `fault` describes them. Without it, the first damaged
    frame raises a LogError.
    """

    def __init__(self, source: Source, *, recover: bool) -> None:
        """Raise LogError for a fault that shows on opening, or if a camera has an invalid name."""
        self._source, self._recover = source, recover
        for name in source.camera_names:
            check_name(name, f"{source.path}: name of a camera", LogError)
        self._indices = range(source.count)
        # Both are shared by all parts of a log. Faults of the whole file have the key -1.
        self._faults: dict[int, str] = {}
        self._open = [True]
        if source.opening_fault:
            if not (recover or source.unfinished):
                raise LogError(source.opening_fault)
            self._faults[-1] = source.opening_fault

    def __repr__(self) -> str:
        return f"Log({self.format}: {len(self)} frames of {', '.join(self.camera_names)})"

    def __exit__(self, *_: object) -> None:
        self.close()

    def __len__(self) -> int:
        """Number of frames, including damaged ones, but not those that a truncated file lacks."""
        return len(self._indices)

    @property
    def missing(self) -> int:
        """Number of frames that a truncated file lacks at its end, if that is known."""
        return self._source.missing

    def __iter__(self) -> Iterator[LogFrame]:
        return with_stamps(self._in_order(), frozenset(self._source.episode_starts))

    def _in_order(self) -> Iterator[LogFrame]:
        """Yield the readable frames whose stamps follow those before; `recover` looks at the next two, too.

        If these follow the frames before and one another, but not this frame, its own stamps are damaged.
        """
        frames, starts = self._frames(), self._source.episode_starts
        near, episode = list(islice(frames, 3 if self._recover else 1)), -1
        while near:
            frame, *after = near
            episodes = {bisect_right(starts, one.index) for one in near}
            if episode != min(episodes):
                episode, order = min(episodes), StampOrder(gaps=self._source.gaps or self._indices.step > 1)
            before, fault = copy(order), self._fault(order, frame)
            faults = [self._fault(copy(order), one) for one in after]
            two = len(faults) == 2 and len(episodes) == 1 and fault is None
            if two and all(faults) and self._fault(copy(before), *after) is None:
                order, fault = before, LogError(f"{faults[0]}; frame {frame.index} is left out")
            if fault is not None:
                self._note(frame.index, fault)
            else:
                yield frame
            near = [*after, *islice(frames, 1)]

    def _fault(self, order: StampOrder, *frames: LogFrame) -> LogError | None:
        """Return the error of the first frame that does not follow those before; None if all do."""
        where = self._source.where
        stamps = ((one.index, one.timestamp, one.camera_timestamps, where(one.index)) for one in frames)
        return next(filter(None, starmap(order.fault, stamps)), None)

    def _frames(self) -> Iterator[LogFrame]:
        for index in self._indices:
            try:
                self._refuse_closed()
                frame = self._source.read(index)
            except LogError as error:
                self._note(index, error)
                if self._source.sequential:
                    return
                continue
            yield frame
        if self._indices and self._indices[-1] == self._source.count - 1:
            try:
                self._source.check_end()
            except LogError as error:
                self._note(-1, error)

    @overload
    def __getitem__(self, key: int) -> LogFrame: ...

    @overload
    def __getitem__(self, key: slice) -> Log: ...

    def __getitem__(self, key: int | slice) -> LogFrame | Log:
        if not isinstance(key, slice):
            return self.frame(key)
        if key.step is not None and key.step < 1:
            raise LogError(f"part of a recording: found the step {key.step}, expected at least 1")
        part = Log.__new__(Log)
        part.__dict__.update(self.__dict__, _indices=self._indices[key])
        return part

    def frame(self, number: int) -> LogFrame:
        """Read one frame; negative numbers count from the end.

        In gzipped recordings this reads all frames before it.

        Raises:
            IndexError: there is no frame with this number.
            LogError: the frame is damaged, even with `recover`.
        """
        if not -len(self) <= number < len(self):
            raise IndexError(f"frame {number}: expected -{len(self)} to {len(self) - 1}")
        self._refuse_closed()
        return self._source.read(self._indices[number])

    @property
    def format(self) -> str:
        """Description of the recording's format."""
        return self._source.format

    @property
    def camera_names(self) -> tuple[str, ...]:
        """Names of the cameras, in the order of the images."""
        return self._source.camera_names

    @property
    def image_sizes(self) -> tuple[tuple[int, int], ...]:
        """(width, height) [px] of each camera's images; empty if the recording has no frame."""
        return self._source.image_sizes

    @property
    def rig(self) -> CameraRig | None:
        """The cameras' calibration from the recording or from files beside it; None if there is none.

        It is not scaled: the images may have another size. TrackerError: it is malformed.
        """
        self._refuse_closed()
        return self._source.rig()

    @property
    def settings(self) -> dict[str, Settings]:
        """Recorded settings (exposure, gain …) by camera name; LogError if they are malformed."""
        self._refuse_closed()
        return self._source.settings()

    @property
    def random_access(self) -> bool:
        """Whether `frame` and slices are quick, without reading all earlier frames."""
        return not self._source.sequential

    @property
    def episode_starts(self) -> tuple[int, ...]:
        """Numbers of the frames at which a filter should restart."""
        return self._source.episode_starts

    @property
    def fault(self) -> str | None:
        """The faults found so far in a log opened with `recover`, on one line; None if there are none."""
        if not self._faults:
            return None
        first, more = self._faults[min(self._faults)], len(self._faults) - 1
        return f"{first} (and {more} more of this recording)" if more else first

    def close(self) -> None:
        """Close the files, for all parts of the log, too."""
        if self._open[0]:
            self._open[0] = False
            self._source.close()

    def _refuse_closed(self) -> None:
        if not self._open[0]:
            raise LogError(f"{self._source.path}: the recording is closed")

    def _note(self, index: int, error: LogError) -> None:
        """Remember the fault if the log is open with `recover`, else raise it."""
        if not (self._recover and self._open[0]):
            raise error
        self._faults.setdefault(index, str(error))


def by_episode(log: Log) -> Iterator[tuple[LogFrame, bool]]:
    """Yield each frame, and whether it is the first one of its episode that is there."""
    episode = -1
    for frame in log:
        before, episode = episode, bisect_right(log.episode_starts, frame.index)
        yield frame, episode != before


def picked(log: Log, numbers: Sequence[int]) -> Iterator[LogFrame]:
    """Yield frames by ascending numbers, as quickly as the format allows; damaged ones as in a slice."""
    if log.random_access:
        for number in numbers:
            yield from log[number : number + 1]
    else:
        chosen = {log._indices[number] for number in numbers}  # damaged frames may be left out before them
        yield from (frame for frame in log if frame.index in chosen)
