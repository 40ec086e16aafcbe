"""A recording: what every format offers, and its frames one after the other, or by number."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import overload

import numpy as np

from tracker.calibration.rig import CameraRig
from tracker.errors import LogError
from tracker.geometry.camera import check_name
from tracker.logs.frame import LogFrame, StampOrder, with_stamps

DEFAULT_NAMES = ("camera60", "camera180", "camera300")
"""The platform's cameras, in the order in which it records them."""


def default_names(count: int) -> tuple[str, ...]:
    """What so many cameras are called where a recording does not say it."""
    return DEFAULT_NAMES if count == len(DEFAULT_NAMES) else tuple(f"camera{k}" for k in range(count))


MIN_SIDE, MAX_SIDE = 8, 4096
"""Least and largest width and height [px] of an image that is believed."""


def check_sides(width: int, height: int, where: str = "") -> None:
    """LogError, which begins with `where`, for images of a size that is not believed."""
    if not (MIN_SIDE <= width <= MAX_SIDE and MIN_SIDE <= height <= MAX_SIDE):
        raise LogError(f"{where}found {width}×{height} px, expected {MIN_SIDE} to {MAX_SIDE}")


def check_same_size(found: tuple[int, ...], size: tuple[int, int], where: str = "") -> None:
    """LogError, which begins with `where`, for another (width, height) than the camera's first image has."""
    if found != size:
        raise LogError(f"{where}found {found[0]}×{found[1]} px, expected {size[0]}×{size[1]} as before it")


Progress = Callable[[int], None]
"""Takes how many more frames are done."""

Settings = Mapping[str, str | int | float | bool]
"""Values of exposure, gain, white balance and others, by the names that the camera's maker gives them."""


def evenly(count: int, most: int) -> list[int]:
    """Up to `most` of the numbers 0 … count - 1, spread evenly."""
    chosen = np.linspace(0, count - 1, min(most, count)).round().astype(int)
    return [int(number) for number in np.unique(chosen)]


class Source(ABC):
    """Reads frames of one recording. Every fault of the recording is a LogError."""

    format: str
    """The format in words."""
    camera_names: tuple[str, ...] = DEFAULT_NAMES
    """Names of the cameras, in order."""
    image_sizes: tuple[tuple[int, int], ...] = ()
    """(width, height) [px] of each camera's images; empty where there is no frame."""
    count: int
    """Number of frames, as far as the file can be believed."""
    sequential: bool = False
    """Whether a frame can be had only by reading all those before it."""
    gaps: bool = False
    """Whether any time may pass between two frames."""
    episode_starts: tuple[int, ...] = (0,)
    """Numbers of the frames at which something new starts, so that what was before tells nothing."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.opening_fault: str | None = None

    @abstractmethod
    def read(self, index: int) -> LogFrame:
        """The frame of this number, 0 ≤ index < count; LogError where it is damaged."""

    def check_end(self) -> None:  # noqa: B027 - most formats have no end to check
        """Called after the last frame; LogError if what follows it is not as it should be."""

    def rig(self) -> CameraRig | None:
        """The cameras' calibration, or None where the recording has none; TrackerError if it is malformed."""
        return rig_beside(self.path.parent, self.camera_names)

    def settings(self) -> dict[str, Settings]:
        """What cameras were set to, by their names, where the recording tells it; LogError if malformed."""
        return {}

    def close(self) -> None:  # noqa: B027 - folders have nothing open
        """Free what is open."""

    def where(self, index: int) -> str:
        """Names a frame in errors."""
        return f"{self.path}: frame {index}"


def rig_beside(folder: Path, names: tuple[str, ...]) -> CameraRig | None:
    """The calibration in the folder, camera60.yml or camera_calib_60.yml of each camera; None without any.

    Raises:
        TrackerError: a file is malformed or of another camera, or only some of the cameras have one.
    """
    files: dict[str, Path] = {}
    for name in names:
        stems = (name, f"camera_calib_{name.removeprefix('camera').lstrip('_')}")
        options = [folder / f"{stem}{suffix}" for stem in stems for suffix in (".yml", ".yaml")]
        if found := [file for file in options if file.is_file()]:
            files[name] = found[0]
    if not files:
        return None
    missing = [name for name in names if name not in files]
    if missing:
        there = ", ".join(file.name for file in files.values())
        raise LogError(
            f"{folder}: found {there}, but no calibration of {', '.join(missing)}; "
            f"expected {missing[0]}.yml, too"
        )
    rig = CameraRig.load(list(files.values()))
    for (name, file), camera in zip(files.items(), rig, strict=True):
        if camera.name != name:
            raise LogError(f"{file}: camera_name: found {camera.name}, expected {name}")
    return rig


class Log:
    """Frames of a recording. A context manager; iterating starts at the first frame each time.

    `log[3]` is a frame, `log[100:200]` a part of the recording, read while you iterate. One frame is in
    memory at a time.

    With `recover`, iterating skips damaged frames, and `fault` describes them. Without it, the first damaged
    frame raises a LogError.
    """

    def __init__(self, source: Source, *, recover: bool) -> None:
        """LogError where the recording's cameras have names that no camera can have."""
        self._source, self._recover = source, recover
        for name in source.camera_names:
            check_name(name, f"{source.path}: name of a camera", LogError)
        self._indices = range(source.count)
        # Shared by the parts of a log. The key of what is wrong with the whole file is -1.
        self._faults: dict[int, str] = {}
        self._open = [True]
        if source.opening_fault:
            self._faults[-1] = source.opening_fault

    def __repr__(self) -> str:
        return f"Log({self.format}: {len(self)} frames of {', '.join(self.camera_names)})"

    def __enter__(self) -> Log:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __len__(self) -> int:
        """Number of frames, as the file states it; damaged ones count."""
        return len(self._indices)

    def __iter__(self) -> Iterator[LogFrame]:
        return with_stamps(self._frames())

    def _frames(self) -> Iterator[LogFrame]:
        order, starts = StampOrder(gaps=self._source.gaps), frozenset(self._source.episode_starts)
        for index in self._indices:
            if index in starts:
                order = StampOrder(gaps=self._source.gaps)
            try:
                self._refuse_closed()
                frame = self._source.read(index)
                order.check(frame, what=self._source.where(index))
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
            raise LogError(f"part of a log: found the step {key.step}, expected at least 1")
        part = Log.__new__(Log)
        part.__dict__.update(self.__dict__, _indices=self._indices[key])
        return part

    def frame(self, number: int) -> LogFrame:
        """One frame; negative numbers count from the end.

        In gzipped recordings this reads all frames before it.

        Raises:
            IndexError: there is no frame of this number.
            LogError: the frame is damaged; with `recover` too.
        """
        if not -len(self) <= number < len(self):
            raise IndexError(f"frame {number}: expected -{len(self)} to {len(self) - 1}")
        self._refuse_closed()
        return self._source.read(self._indices[number])

    @property
    def format(self) -> str:
        """The recording's format, in words."""
        return self._source.format

    @property
    def camera_names(self) -> tuple[str, ...]:
        """Names of the cameras, in the order of the images."""
        return self._source.camera_names

    @property
    def image_sizes(self) -> tuple[tuple[int, int], ...]:
        """(width, height) [px] of each camera's images; empty where the recording has no frame."""
        return self._source.image_sizes

    @property
    def rig(self) -> CameraRig | None:
        """The cameras' calibration from inside the recording or from files beside it; None without one.

        It is not scaled: the images may have another size.

        Raises:
            TrackerError: there is one, but it is malformed.
        """
        self._refuse_closed()
        return self._source.rig()

    @property
    def settings(self) -> dict[str, Settings]:
        """What cameras were set to (exposure, gain, white balance …), by their names, where that is recorded.

        Raises:
            LogError: it is malformed.
        """
        self._refuse_closed()
        return self._source.settings()

    @property
    def random_access(self) -> bool:
        """Whether `frame` and parts are quick: they need not read the frames before."""
        return not self._source.sequential

    @property
    def episode_starts(self) -> tuple[int, ...]:
        """Numbers of the frames at which a filter should restart."""
        return self._source.episode_starts

    @property
    def fault(self) -> str | None:
        """The faults found so far in a log opened with `recover`, in one line; None if there are none."""
        if not self._faults:
            return None
        first = self._faults[min(self._faults)]
        more = len(self._faults) - 1
        return first if not more else f"{first} (and {more} more of this recording)"

    def close(self) -> None:
        """Close the files; also those of all parts."""
        if self._open[0]:
            self._open[0] = False
            self._source.close()

    def _refuse_closed(self) -> None:
        if not self._open[0]:
            raise LogError(f"{self._source.path}: the log is closed")

    def _note(self, index: int, error: LogError) -> None:
        """Keep the fault where faults are left out; else raise it."""
        if not (self._recover and self._open[0]):
            raise error
        self._faults.setdefault(index, str(error))


def picked(log: Log, numbers: Sequence[int]) -> Iterator[LogFrame]:
    """Frames of a log by ascending numbers, as quickly as its format allows; errors as of `frame`."""
    if log.random_access:
        yield from map(log.frame, numbers)
    else:
        chosen = set(numbers)
        yield from (frame for number, frame in enumerate(log) if number in chosen)
