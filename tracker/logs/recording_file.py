"""What a folder says of the recording in it, where names do not: `recording.toml`, and `stamps.csv`.

    rate = 30.0                    # frames per second [Hz] where neither names nor films tell the time

    [cameras]                      # of each camera its pictures, or its film
    camera60 = "left/*.png"
    camera180 = "right_*.jpg"
    camera300 = "above.mp4"

Patterns are relative to the folder. Pictures of one moment agree in what `*` stands for; where no two cameras
agree in any, they are counted. `stamps.csv` has a line for each frame, with its time [s], or with one of
each camera, in the order of [cameras].
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tracker.checks import is_number
from tracker.conventions import FloatArray
from tracker.errors import LogError, shown
from tracker.files import read_bounded, told_of
from tracker.files.toml import read_toml

FILE_NAME, STAMPS_NAME = "recording.toml", "stamps.csv"

_MAX_STAMPS = 100_000_000  # bytes
_MAX_CAMERAS = 16
_MAX_RATE = 1e6


@dataclass(frozen=True, eq=False)
class RecordingFile:
    """What the file states."""

    cameras: dict[str, dict[str, Path]]
    """Of each camera its files, by what the pattern's `*` stands for, in the order of their names."""
    rate: float | None
    """Frames per second [Hz], or None where it is not stated."""
    stamps: FloatArray | None
    """(frames, 1) or (frames, cameras) times [s], or None where they are not stated."""


def read_recording_file(folder: Path) -> RecordingFile | None:
    """What the two files say; None where there is no such file, LogError where one is malformed."""
    path = folder / FILE_NAME
    if not path.is_file():
        return None
    values = read_toml(path, LogError, ("cameras", "rate"))
    patterns = values.get("cameras")
    if not isinstance(patterns, dict) or not 0 < len(patterns) <= _MAX_CAMERAS:
        raise LogError(f"{path}: cameras: expected a table of 1 to {_MAX_CAMERAS} patterns by cameras' names")
    cameras = {name: _files(path, name, pattern) for name, pattern in patterns.items()}
    rate = check_rate(values["rate"], f"{path}: rate") if "rate" in values else None
    return RecordingFile(cameras, rate, _stamps(folder, len(cameras)))


def _files(path: Path, camera: str, pattern: Any) -> dict[str, Path]:
    if not isinstance(pattern, str) or not pattern or "\0" in pattern:
        raise LogError(f"{path}: {camera}: found {pattern!r:.60}, expected a pattern such as 'left/*.png'")
    parts = Path(pattern).parts
    if Path(pattern).is_absolute() or ".." in parts or "**" in parts:
        raise LogError(
            f"{path}: {camera}: found {pattern!r:.60}, expected one inside of the folder, without **"
        )
    shape = re.compile("([^/]*)".join(map(re.escape, "/".join(parts).split("*"))))
    found: dict[str, Path] = {}
    for file in sorted(path.parent.glob(pattern)):
        match = shape.fullmatch(file.relative_to(path.parent).as_posix())
        if match is None or not file.is_file():
            continue
        key = "_".join(match.groups())
        if key in found:
            raise LogError(f"{file}: found {found[key].name} too, expected one picture of a moment")
        found[key] = file
    if not found:
        raise LogError(
            f"{path}: {camera}: found no file that fits {pattern!r:.60}, expected pictures or a film"
        )
    return found


def check_rate(value: Any, what: str) -> float:
    """A rate [Hz]; LogError, which names `what`, where it is none."""
    if not is_number(value) or not 0 < value <= _MAX_RATE:
        raise LogError(f"{what}: found {shown(value)}, expected a number of Hz above 0")
    return float(value)


def _stamps(folder: Path, cameras: int) -> FloatArray | None:
    path = folder / STAMPS_NAME
    if not path.is_file():
        return None
    with told_of(path):
        content = read_bounded(path, _MAX_STAMPS)
    try:
        rows = [line.split(",") for line in content.decode("utf-8-sig").splitlines() if line.strip()]
        stamps = np.array(rows, np.float64)
    except ValueError as error:
        raise LogError(f"{path}: found no table of numbers: {' '.join(str(error).split())}") from error
    if stamps.ndim != 2 or stamps.shape[1] not in (1, cameras) or not np.isfinite(stamps).all():
        raise LogError(f"{path}: expected finite numbers, one or {cameras} in each line")
    return stamps
