"""The poses that were found in a recording: all frames, and what they were made from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, Literal

import numpy as np

from tracker.calibration.rig import CameraRig
from tracker.conventions import Array, FloatArray
from tracker.errors import LogError
from tracker.poses.columns import (
    FilteredColumns,
    MeasuredColumns,
    PoseColumns,
    described,
    float_array,
    refuse,
)
from tracker.poses.table import CSV_HEADER, along_frames, camera_cells, numbers_of, package

Kind = Literal["measured", "filtered", "recorded"]
"""Which of a frame's poses."""

KINDS: dict[Kind, type[PoseColumns]] = {
    "measured": MeasuredColumns,
    "filtered": FilteredColumns,
    "recorded": PoseColumns,
}
"""What is known of each kind of pose."""


@dataclass(frozen=True, eq=False)
class About:
    """What the poses were made from, and by what.

    Raises:
        LogError: a text is none, or holds a null character or what is no Unicode (as file names can).
    """

    object_name: str
    """The object, e.g. `cube_v2`."""
    source: str
    """The recording, e.g. the name of its file."""
    tracker_version: str
    """Version of this package."""
    rig: CameraRig
    """The cameras, as they were calibrated."""
    fingerprint: str = ""
    """Digits that are others for another recording, object, calibration, choice or code; empty: unknown."""
    fault: str = ""
    """What is wrong with the recording, of which the poses are what could be recovered; empty: nothing."""

    def __post_init__(self) -> None:
        for name in ("object_name", "source", "tracker_version", "fingerprint", "fault"):
            value = getattr(self, name)
            if not isinstance(value, str) or "\0" in value or not _is_unicode(value):
                raise LogError(
                    f"{name}: found {ascii(value)[:80]}, expected Unicode text without null characters"
                )

    def agrees_with(self, other: About) -> bool:
        """Whether object and cameras are the same, to the bit."""
        return (
            self.object_name == other.object_name
            and self.rig.names == other.rig.names
            and all(
                np.array_equal(getattr(first, field.name), getattr(second, field.name))
                for first, second in zip(self.rig, other.rig, strict=True)
                for field in fields(first)
            )
        )


@dataclass(frozen=True, eq=False)
class Poses:
    """Poses of n frames in columns. Arrays are copied and read-only.

    `poses[10:20]` and `poses[mask]` are the poses of some of the frames.

    Raises:
        LogError: columns differ in length, or hold what they cannot.
    """

    index: Array
    """(n,) int64: numbers of the frames in the recording, increasing, the first of all is 0."""
    timestamp: FloatArray
    """(n,) time of each frame [s]."""
    status: Array
    """(n,) text: why there is a pose, or none; the values of `tracker.Status`."""
    measured: MeasuredColumns
    """Poses measured in the images of each frame alone."""
    filtered: FilteredColumns
    """Poses fused over time, with velocities."""
    recorded: PoseColumns | None
    """Poses that the recording brings along; None where it has none at all."""
    about: About
    """What the poses were made from."""
    cameras: Array | None = None
    """(n, C) text: what became of each camera's picture, in the order of the rig; the values of
    `tracker.CameraUse`, empty where it is not known. None where nothing is."""

    def __post_init__(self) -> None:
        index = np.array(self.index)
        if index.ndim != 1 or (index.size and index.dtype.kind not in "iu"):
            raise LogError(f"index: found {described(index)}, expected whole numbers of shape (n,)")
        _freeze(self, "index", index.astype(np.int64))
        count = len(index)
        bad = np.diff(self.index, prepend=-1) <= 0
        refuse("index", bad, self.index, "frame numbers from 0 on that increase")
        object.__setattr__(self, "timestamp", float_array("timestamp", self.timestamp, (count,)))
        refuse("timestamp", ~np.isfinite(self.timestamp), self.timestamp, "a finite time in seconds")
        _freeze(self, "status", _texts("status", self.status, (count,)))
        if self.cameras is not None:
            _freeze(self, "cameras", _texts("cameras", self.cameras, (count, len(self.about.rig))))
        for kind, columns_type in KINDS.items():
            columns: object = getattr(self, kind)
            if kind == "recorded" and columns is None:
                continue
            if type(columns) is not columns_type:
                found = type(columns).__name__
                raise LogError(f"{kind}: found {found}, expected {columns_type.__name__}")
            if len(columns) != count:
                raise LogError(f"{kind}: found {len(columns)} frames, expected {count}")

    def __len__(self) -> int:
        return len(self.index)

    def __getitem__(self, rows: slice | Array) -> Poses:
        return Poses(
            index=self.index[rows],
            timestamp=self.timestamp[rows],
            status=self.status[rows],
            measured=self.measured.take(rows),
            filtered=self.filtered.take(rows),
            recorded=None if self.recorded is None else self.recorded.take(rows),
            about=self.about,
            cameras=None if self.cameras is None else self.cameras[rows],
        )

    def table(self) -> dict[str, Array]:
        """(n,) columns under the CSV file's header: numbers with NaN where there is none, and texts."""
        cells = camera_cells(_cameras(self))
        numbers = numbers_of(self.measured, self.filtered, self.recorded)
        columns = [self.index, self.timestamp, self.status, *numbers.T, cells]
        return dict(zip(CSV_HEADER, columns, strict=True))

    def to_dataframe(self) -> Any:
        """A pandas DataFrame, one row a frame, with the columns of the CSV file; see docs/poses.md.

        Raises:
            TrackerError: the package pandas is missing.
        """
        return package("pandas").DataFrame(self.table()).set_index("frame")

    def to_xarray(self) -> Any:
        """An xarray Dataset along `frame`, with whole vectors and covariances, e.g. `filtered_position`.

        Raises:
            TrackerError: the package xarray is missing.
        """
        variables: dict[str, Any] = {"timestamp": ("frame", self.timestamp), "status": ("frame", self.status)}
        if self.cameras is not None:
            variables["cameras"] = (("frame", "camera"), self.cameras)
        variables |= along_frames({kind: getattr(self, kind) for kind in KINDS})
        coordinates = {
            "frame": self.index,
            "axis": list("xyz"),
            "xyzw": list("xyzw"),
            "camera": list(self.about.rig.names),
        }
        about = {name: getattr(self.about, name) for name in ("object_name", "source", "tracker_version")}
        return package("xarray").Dataset(variables, coords=coordinates, attrs=about)

    def columns(self, kind: Kind) -> PoseColumns:
        """The poses of a kind.

        Raises:
            LogError: there is no such kind, or the recording has no poses.
        """
        if kind not in KINDS:
            raise LogError(f"kind of poses: found {kind!r}, expected one of {', '.join(KINDS)}")
        columns: PoseColumns | None = getattr(self, kind)
        if columns is None:
            raise LogError(f"{self.about.source}: found no recorded poses, expected measured or filtered")
        return columns


def concatenate(parts: Sequence[Poses]) -> Poses:
    """The poses of consecutive parts of one recording; sources that differ are listed.

    Raises:
        LogError: there is no part, their frames do not follow each other, or object or cameras differ.
    """
    if not parts:
        raise LogError("parts: found none, expected at least one")
    first = parts[0].about
    for number, part in enumerate(parts):
        if not first.agrees_with(part.about):
            found = f"{part.about.object_name} seen by {', '.join(part.about.rig.names)}"
            expected = f"{first.object_name} seen by {', '.join(first.rig.names)} of the same calibration"
            raise LogError(f"part {number}: found {found}, expected {expected}")
    recorded = [PoseColumns.nothing(len(part)) if part.recorded is None else part.recorded for part in parts]
    cameras = [_cameras(part) for part in parts]
    sources = dict.fromkeys(part.about.source for part in parts)
    return Poses(
        index=np.concatenate([part.index for part in parts]),
        timestamp=np.concatenate([part.timestamp for part in parts]),
        status=np.concatenate([part.status for part in parts]),
        measured=MeasuredColumns.joined([part.measured for part in parts]),
        filtered=FilteredColumns.joined([part.filtered for part in parts]),
        recorded=PoseColumns.joined(recorded) if any(part.recorded is not None for part in parts) else None,
        about=About(first.object_name, ", ".join(sources), first.tracker_version, first.rig),
        cameras=np.concatenate(cameras) if any(part.cameras is not None for part in parts) else None,
    )


def _cameras(part: Poses) -> Array:
    """(n, C) what became of each picture, unknown where a part does not say."""
    return np.full((len(part), len(part.about.rig)), "") if part.cameras is None else part.cameras


def _is_unicode(text: str) -> bool:
    # Python keeps bytes of file names that are no UTF-8 as lone surrogates.
    return not any("\ud800" <= character <= "\udfff" for character in text)


def _texts(name: str, value: object, shape: tuple[int, ...]) -> Array:
    texts = np.array(value)
    if texts.shape != shape or (texts.size and texts.dtype.kind != "U"):
        raise LogError(f"{name}: found {described(texts)}, expected texts of shape {shape}")
    return texts.astype(np.str_)


def _freeze(poses: Poses, name: str, array: Array) -> None:
    array.flags.writeable = False
    object.__setattr__(poses, name, array)
