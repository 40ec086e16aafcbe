"""Films of recordings: the cameras side by side."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator

import numpy as np

from tracker.conventions import Image
from tracker.logs import Log
from tracker.viz.film import write_film

MIN_RATE, MAX_RATE = 0.5, 60.0
"""Slowest and fastest film [frames per second]."""

_LOOK = 100  # frames that tell the rate


def write_log_film(path: str | os.PathLike[str], log: Log, progress: Callable[[int], None]) -> None:
    """Write frames as a film with the cameras side by side, black where one gave no image.

    Raises:
        TrackerError: a frame cannot be read, the film not be written, or the package av is missing.
    """
    steps = np.diff([frame.timestamp for frame in log[:_LOOK]])
    steps = steps[steps > 0]
    rate = float(np.clip(1 / np.median(steps), MIN_RATE, MAX_RATE)) if len(steps) else 10.0
    write_film(path, _side_by_side(log, progress), rate)


def _side_by_side(log: Log, progress: Callable[[int], None]) -> Iterator[Image]:
    height = max((size[1] for size in log.image_sizes), default=0)
    for frame in log:
        pictures = []
        for image, (width, rows) in zip(frame.images, log.image_sizes, strict=True):
            canvas = np.zeros((height, width, 3), np.uint8)
            if image is not None:
                canvas[:rows] = image
            pictures.append(canvas)
        yield np.concatenate(pictures, axis=1)
        progress(1)
