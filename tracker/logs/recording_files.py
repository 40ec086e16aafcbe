"""Which files a recording consists of, without opening it."""

from __future__ import annotations

import functools
import os
from pathlib import Path

from tracker.logs import films, recording_file
from tracker.logs.folder import TRUTH_FILE
from tracker.logs.folder_layout import SUFFIXES

JOB_LOGS = ("camera_data.dat", "camera_data.dat.gz", "camera_data.h5", "camera_data.hdf5")
"""Names of a recording in a job's folder."""

_BESIDE = (TRUTH_FILE, recording_file.FILE_NAME, recording_file.STAMPS_NAME)
"""Files of a folder that tell of its pictures."""

STORE_FILE = "data.mdb"
"""What an image store consists of."""


def recording_files(path: Path) -> list[Path]:
    """All files that `open_log` may read frames from, in the same order each time.

    Raises:
        OSError: a folder cannot be read.
    """
    if not path.is_dir():
        return [path]
    found = [path / name for name in (*JOB_LOGS, STORE_FILE) if (path / name).is_file()]
    return found or [file for file in _visible_files(path) if _is_of_folder(file)]


def calibration_files(path: Path) -> list[Path]:
    """The files beside the recording, or in its folder, that its own calibration may be read from."""
    folders = [path.parent]
    if path.is_dir():
        of_job = any((path / name).is_file() for name in JOB_LOGS)
        folders = [path] if of_job else [path, path.parent]
    return [Path(file) for folder in folders for file in _calibration_in(folder, folder.stat().st_mtime_ns)]


@functools.lru_cache(maxsize=64)
def _calibration_in(folder: Path, _: int) -> list[str]:
    """Paths of the calibration files in a folder, as it was at a time: many recordings may share it."""
    names = sorted(entry.name for entry in os.scandir(folder) if _is_of_calibration(entry.name))
    return [os.path.join(folder, name) for name in names]


def _is_of_folder(file: Path) -> bool:
    return file.suffix.lower() in (*SUFFIXES, *films.SUFFIXES) or file.name in _BESIDE


def _is_of_calibration(name: str) -> bool:
    return (name.endswith((".yml", ".yaml")) and "camera" in name) or name == "arena.toml"


def _visible_files(root: Path) -> list[Path]:
    found = []
    for folder, folders, names in os.walk(root, onerror=_refuse):
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        found += [Path(folder) / name for name in sorted(names) if not name.startswith(".")]
    return found


def _refuse(error: OSError) -> None:
    raise error
