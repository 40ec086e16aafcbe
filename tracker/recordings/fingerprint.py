"""What the poses of a recording depend on, so that those of an earlier run are used only where they fit.

Names, sizes and times of change of the recording's files and of the calibration beside it stand for their
content, which would take as long to read as to track.
"""

from __future__ import annotations

import functools
import hashlib
import os
from collections.abc import Iterator
from pathlib import Path

import cv2
import numba
import numpy as np
import scipy

import tracker
from tracker.logs.opening import calibration_files, recording_files
from tracker.recordings.recipe import Job

_OTHER_ROOMS = ("cli", "viz", "learning", "upkeep", "live", "tasks")
"""Rooms of the package on which no pose depends."""


def fingerprint(job: Job) -> str:
    """Hexadecimal digits that differ where the poses might.

    Raises:
        OSError: the recording cannot be looked at.
    """
    recipe = job.recipe
    digest = hashlib.sha256(f"{code()}\0{recipe.digest}\0".encode())
    digest.update(os.fsencode(os.path.abspath(job.log)))
    files = list(recording_files(job.log))
    if recipe.rig is None:
        files += calibration_files(job.log)
    for path in files:
        digest.update(_about(path, job.log))
    return digest.hexdigest()


@functools.cache
def code() -> str:
    """Hash of what computes poses: this package's sources, and the versions of the libraries below it."""
    versions = [module.__version__ for module in (np, scipy, cv2, numba)]
    digest = hashlib.sha256(repr(versions).encode())
    root = Path(tracker.__file__).parent
    for path in sorted(_sources(root)):
        digest.update(f"\0{path.relative_to(root)}\0".encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()


def _sources(root: Path) -> Iterator[Path]:
    for path in root.rglob("*.py"):
        if path.relative_to(root).parts[0] not in _OTHER_ROOMS:
            yield path


def _about(path: Path, log: Path) -> bytes:
    about = path.stat()
    name = os.fsencode(os.path.relpath(path, log))
    return name + f"\0{about.st_size}\0{about.st_mtime_ns}\0".encode()
