"""The recording that poses are of: whether it is this one, and when it began."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tracker.conventions import FloatArray
from tracker.errors import LogError
from tracker.logs import Log, open_log
from tracker.poses.poses import Poses

SAME = 1e-3
"""Time [s] by which stamps of one frame may differ: formats round them."""


def refuse_others(path: Path, poses: Poses, recording: Path, log: Log) -> None:
    """Refuse poses of another recording, as far as number and stamp of their first and last frame tell.

    Raises:
        LogError: they are, or one of these frames is damaged.
    """
    if not len(poses):
        return
    for row in (0, -1):
        number = int(poses.index[row])
        stamp = log.frame(number).timestamp if number < len(log) else np.inf
        if abs(stamp - poses.timestamp[row]) > SAME:  # not so where a driver's error left no stamp, NaN
            source = poses.about.source
            raise LogError(
                f"{path}: found poses of another recording ({source}), expected those of {recording}"
            )
        if not log.random_access:
            return  # to read all of it takes long


def seconds_since_beginning(log: Path, poses: Poses) -> FloatArray:
    """Times (n,) [s] of poses since the first frame of their recording, from which goals count.

    Raises:
        LogError, OSError: the poses begin later, and the recording cannot be read.
    """
    if not len(poses) or poses.index[0] == 0:
        return poses.timestamp - poses.timestamp[:1]
    with open_log(log, recover=True) as opened:
        first = next(iter(opened), None)
    if first is None:
        raise LogError(f"{log}: found no frame that can be read, expected the first one")
    return poses.timestamp - first.timestamp
