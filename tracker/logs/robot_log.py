"""The robot's states at the times of the images, read from the platform's robot logs.

A log is text, one line per step after a header of names, or binary, version 2; either may be gzipped.
"""

import gzip
import os
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, fields
from itertools import chain, islice
from typing import Any, BinaryIO, NamedTuple, cast

import numpy as np

from tracker.checks import Frozen, array_of, float_array, freeze, in_range, naming, of_kind, path_of, seconds
from tracker.conventions import Array, FloatArray
from tracker.errors import LogError
from tracker.files import open_regular, reading
from tracker.logs.frame import LogFrame
from tracker.logs.log import Log

MAX_STEPS = 4_000_000
"""Largest number of steps in a log: over an hour at 1 kHz."""

MAX_LINE = 1 << 16
"""Longest valid line [bytes]; typical lines have 3 kB."""

_JOINTS = 9
_VERSION = 2
_BLOCK = 4096  # steps read at once
_RECORD = np.dtype(
    [("step", "<i8"), ("timestamp", "<f8"), ("repetitions", "<u4"), ("error", "<i4"), ("message", "S64")]
    + [(name, "<f8", _JOINTS) for name in ("position", "velocity", "torque")]
    + [("tip_force", "<f8", 3), ("actions", "<f8", 8 * _JOINTS)]
)
_UNITS = {"position": "rad", "velocity": "rad_per_s", "torque": "nm"}


@dataclass(frozen=True, eq=False)
class RobotState:
    """The robot's state at times of any shape S; NaN before the log's first step and after its last."""

    position: FloatArray
    """S + (J,) joint angles [rad], interpolated between two steps."""
    velocity: FloatArray | None
    """S + (J,) joint velocities [rad/s]; None: unknown."""
    torque: FloatArray | None
    """S + (J,) joint torques [N m]; None: unknown."""
    gap: FloatArray
    """S time between the two steps [s]; infinite outside the log."""

    def columns(self) -> dict[str, Array]:
        """Return columns (n,) of n states for tables: `robot_position_0_rad` and others, `robot_gap_s`."""
        found: dict[str, Array] = {}
        for name, unit in _UNITS.items():
            values: FloatArray | None = getattr(self, name)
            if values is not None:
                found |= {f"robot_{name}_{k}_{unit}": column for k, column in enumerate(values.T)}
        return {**found, "robot_gap_s": self.gap}


@dataclass(frozen=True, eq=False)
class RobotLog(Frozen):
    """The robot's states at all steps. Arrays are copied and read-only.

    Raises:
        LogError: an array has the wrong shape or is not finite, there are fewer than two steps, or
            timestamps go backwards.
    """

    timestamp: FloatArray
    """(n,) time of each step, on the cameras' clock [s]."""
    position: FloatArray
    """(n, J) joint angles [rad]."""
    velocity: FloatArray | None = None
    """(n, J) joint velocities [rad/s]; None: unknown."""
    torque: FloatArray | None = None
    """(n, J) joint torques [N m]; None: unknown."""

    def __post_init__(self) -> None:
        times = in_range(np.array(seconds(self.timestamp, "timestamp", LogError)), "timestamp", LogError)
        if times.ndim != 1 or len(times) < 2:
            raise LogError(f"timestamp: found shape {times.shape}, expected times of two steps or more")
        back = np.diff(times) < 0
        if back.any():
            k = int(np.argmax(back)) + 1
            raise LogError(f"timestamp: step {k}: found {times[k]:.6f} s after {times[k - 1]:.6f} s")
        freeze(self, "timestamp", times)
        shape = array_of(self.position).shape
        if len(shape) != 2:
            raise LogError(f"position: found shape {shape}, expected (n, J)")
        for field in fields(self)[1:]:
            given = getattr(self, field.name)
            if given is not None:
                freeze(self, field.name, float_array(given, (len(times), shape[1]), field.name, LogError))

    def at(self, stamps: float | FloatArray) -> RobotState:
        """Return the states at times of any shape [s]; LogError if these are not numbers of seconds."""
        times = seconds(stamps, "stamps", LogError)
        places = np.interp(times, self.timestamp, np.arange(len(self.timestamp)), left=np.nan, right=np.nan)
        outside = np.isnan(places)
        before = np.where(outside, 0, np.clip(places, 0, len(self.timestamp) - 2)).astype(int)
        weight = (places - before)[..., None]
        gap = np.where(outside, np.inf, self.timestamp[before + 1] - self.timestamp[before])[()]  # a scalar

        def between(values: FloatArray | None) -> Any:
            return None if values is None else (1 - weight) * values[before] + weight * values[before + 1]

        return RobotState(between(self.position), between(self.velocity), between(self.torque), gap)


class Paired(NamedTuple):
    """A set of images, and the robot's state at the time of the newest."""

    frame: LogFrame
    robot: RobotState


def paired(log: Log, robot_log: RobotLog | str | os.PathLike[str]) -> Iterator[Paired]:
    """Yield each set of images of a recording with the robot's state at the time of the newest.

    Args:
        log: the recording from `open_log`, or a part of it.
        robot_log: path of the platform's robot log, or its states from `read_robot_log`.

    Raises:
        LogError: one of them is malformed or damaged.
    """
    of_kind(log, Log, "log", LogError, "tracker.open_log")
    states = robot_log if isinstance(robot_log, RobotLog) else read_robot_log(robot_log)
    return (Paired(frame, states.at(frame.newest)) for frame in log)


def read_robot_log(path: str | os.PathLike[str]) -> RobotLog:
    """Read the platform's `robot_data.dat` or `.csv`, also gzipped; LogError if it is damaged or too long."""
    where = path_of(path, "path of a robot log", LogError)
    with reading(where), naming(where, LogError, LogError, EOFError, zlib.error), open_regular(where) as raw:
        packed = raw.read(2) == b"\x1f\x8b"
        raw.seek(0)
        with cast("BinaryIO", gzip.open(raw) if packed else raw) as file:
            head = file.read(4)
            binary = head == struct.pack("<I", _VERSION)
            names, table = _records(file) if binary else _lines(file, head)
        times = table[:, 0]
        if np.nanmin(times, initial=np.inf) > 1e11:  # milliseconds
            times = times / 1000
        return RobotLog(times, **dict(zip(names, np.split(table[:, 1:], len(names), axis=1), strict=True)))


def _records(file: BinaryIO) -> tuple[list[str], Array]:
    """Read a binary log after its version: names of the fields, and one row (1 + 9 per field) per step."""
    head = file.read(8)
    count = int.from_bytes(head, "little")
    if len(head) < 8 or count > MAX_STEPS:
        raise LogError(f"found {count} steps stated, expected at most {MAX_STEPS}")
    names = list(_UNITS)
    blocks = [np.empty((0, 1 + len(names) * _JOINTS))]
    for first in range(0, count, _BLOCK):
        chosen = min(_BLOCK, count - first)
        content = file.read(chosen * _RECORD.itemsize)
        if len(content) < chosen * _RECORD.itemsize:
            there = first + len(content) // _RECORD.itemsize
            raise LogError(f"found {there} records of {_RECORD.itemsize} bytes, expected {count}")
        records = np.frombuffer(content, _RECORD)
        blocks.append(np.column_stack([records[name] for name in ("timestamp", *names)]))
    if file.read(1):
        raise LogError(f"found bytes after record {count - 1}, expected the file's end")
    return names, np.concatenate(blocks)


def _lines(file: BinaryIO, head: bytes) -> tuple[list[str], Array]:
    """Read the same from a text log, whose first line begins with `head`."""
    header = head + file.readline(MAX_LINE)
    if not header.startswith(b"#"):
        found = f"{header[:20]!r} at its beginning"
        raise LogError(f"found {found}, expected a robot log: #time_index timestamp …, or version {_VERSION}")
    columns = header.decode("ascii", "replace").lstrip("#").split()
    fields = {name: [f"observation_{name}_{k}" for k in range(_JOINTS)] for name in _UNITS}
    missing = [one for one in ("timestamp", *fields["position"]) if one not in columns]
    if missing:
        raise LogError(f"header: found no column {missing[0]}, expected it, with spaces between columns")
    names = [name for name, one in fields.items() if set(one) <= set(columns)]
    places = [columns.index(one) for name in names for one in fields[name]]
    places.insert(0, columns.index("timestamp"))
    first = file.readline(MAX_LINE)
    if not first:
        raise LogError("found no steps, expected two or more")

    def rows() -> Iterator[bytes]:
        for row, line in enumerate(chain([first], iter(lambda: file.readline(MAX_LINE), b""))):
            if (found := len(line.split())) not in (0, len(columns)):
                raise ValueError(f"found {found} cells at row {row}, expected {len(columns)}")
            yield line

    with naming("after the header", LogError, ValueError):
        table = np.loadtxt(islice(rows(), MAX_STEPS + 1), usecols=places, ndmin=2, comments=None)
    if len(table) > MAX_STEPS:
        raise LogError(f"found more than {MAX_STEPS} steps, expected a log of a job")
    return names, table
