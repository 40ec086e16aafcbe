"""What the poses of a part depend on, so that those of an earlier run are used only where they fit."""

from __future__ import annotations

import dataclasses
import hashlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from tracker.recordings.job import Job
from tracker.recordings.parts import PART, RUN_UP
from tracker.version import version


def fingerprint(job: Job) -> dict[str, Any]:
    """Plain values that differ where the poses might.

    Raises:
        OSError: the recording cannot be looked at.
    """
    colors = [np.array(job.colors.normalise), job.colors.log_posterior]
    return {
        "version": version(),
        "part": PART,
        "run_up": RUN_UP,
        "log": os.path.abspath(job.log),
        "files": _digest(_files(job.log)),
        "first": job.first,
        "last": job.last,
        "recover": job.recover,
        "tracker": f"{job.make_tracker.__module__}.{job.make_tracker.__qualname__}",
        "object": [job.model.name, job.model.size.tolist(), job.model.face_labels.tolist()],
        "colors": _digest(array.tobytes() for array in colors),
        "calibration": _digest(_fields(part) for part in (*job.rig, job.rig.arena)),
    }


def _files(log: Path) -> Iterator[bytes]:
    """Name, size and time of change of the recording's files."""
    if not log.is_dir():
        yield _file(log, log)
        return
    for folder, folders, names in os.walk(log):
        # Hidden are the parts themselves, and files that are being written.
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        for name in sorted(names):
            if not name.startswith("."):
                yield _file(Path(folder) / name, log)


def _file(path: Path, log: Path) -> bytes:
    about = path.stat()
    return os.fsencode(path.relative_to(log)) + f"\0{about.st_size}\0{about.st_mtime_ns}\0".encode()


def _fields(part: Any) -> bytes:
    values = [getattr(part, field.name) for field in dataclasses.fields(part)]
    texts = [value.tobytes().hex() if isinstance(value, np.ndarray) else repr(value) for value in values]
    return "\0".join(texts).encode()


def _digest(contents: Iterator[bytes]) -> str:
    digest = hashlib.sha256()
    for content in contents:
        digest.update(hashlib.sha256(content).digest())
    return digest.hexdigest()
