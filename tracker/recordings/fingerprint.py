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

from tracker.logs.opening import calibration_files, recording_files
from tracker.recordings.recipe import Job

_OTHERS = (
    *("batch", "cli", "color_learning", "calibration/board", "calibration/by_object", "live"),
    *("summaries", "tasks", "viz"),
)
"""Parts of the package on which no pose depends."""


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
    root = Path(__file__).parents[1]
    for path in sorted(_sources(root)):
        digest.update(f"\0{path.relative_to(root)}\0".encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()


def _sources(root: Path) -> Iterator[Path]:
    for path in root.rglob("*.py"):
        if not path.relative_to(root).as_posix().startswith(tuple(f"{name}/" for name in _OTHERS)):
            yield path


def _about(path: Path, log: Path) -> bytes:
    about = path.stat()
    name = os.fsencode(os.path.relpath(path, log))
    return name + f"\0{about.st_size}\0{about.st_mtime_ns}\0".encode()
