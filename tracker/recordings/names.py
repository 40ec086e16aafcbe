"""Names of results: the recordings' own paths, in another folder."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from tracker.errors import LogError

SUFFIX = ".poses.h5"
"""What the file of poses is called after its recording's name."""


def output_of(log: Path, folder: Path) -> Path:
    """The file of poses of a recording in a folder: `folder/a/b.dat.poses.h5` of `a/b.dat`.

    It depends on this recording alone, so that more of them can be added later. Relative paths are mirrored
    as they are given, others from the file system's root on.
    """
    path = Path(os.path.normpath(log))
    if path.is_absolute() or ".." in path.parts or not path.parts:
        path = Path(os.path.abspath(log))
        path = path.relative_to(path.anchor)
    return folder / path.parent / f"{path.name}{SUFFIX}"


def outputs_of(logs: Sequence[Path], folder: Path) -> list[Path]:
    """The file of poses of each recording.

    Raises:
        LogError: a recording is given twice.
    """
    outputs: dict[Path, Path] = {}
    for log in logs:
        output = output_of(log, folder)
        if output in outputs:
            raise LogError(f"{log}: found {outputs[output]} too, expected each recording once")
        outputs[output] = log
    return list(outputs)
