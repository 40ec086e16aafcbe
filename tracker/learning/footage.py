"""Frames of recordings from which colours are learned, and others by which what was learned is judged."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tracker.calibration.rig import CameraRig
from tracker.conventions import Image
from tracker.logs import Log

Images = tuple[Image | None, ...]
"""(H, W, 3) BGR of each camera of a rig, None where it gave none."""


LEAST = 3
"""Frames below which nothing is learned."""


@dataclass(frozen=True, eq=False)
class Footage:
    """Frames of one recording."""

    rig: CameraRig
    """Its cameras."""
    learned: tuple[Images, ...]
    """Frames that teach."""
    held_out: tuple[Images, ...]
    """Frames that judge."""


def footage(log: Log, rig: CameraRig, count: int) -> Footage:
    """Up to `count` frames spread evenly over a recording: every other one teaches, the rest judge.

    Raises:
        LogError: the recording is damaged.
    """
    wanted = np.unique(np.linspace(0, len(log) - 1, min(count, len(log))).round().astype(int)).tolist()
    if log.random_access:
        frames = [log.frame(index).images for index in wanted]
    else:
        chosen = set(wanted)
        frames = [frame.images for frame in log if frame.index in chosen]
    frames = [images for images in frames if any(image is not None for image in images)]
    return Footage(rig, tuple(frames[::2]), tuple(frames[1::2]))


def shares(lengths: Sequence[int], count: int) -> list[int]:
    """How many of `count` frames each of several recordings gives: as many each, as far as they reach."""
    result, left = [0] * len(lengths), count
    order = sorted(range(len(lengths)), key=lambda k: lengths[k])
    for place, k in enumerate(order):
        result[k] = min(lengths[k], max(2, left // (len(order) - place)))
        left -= result[k]
    return result
