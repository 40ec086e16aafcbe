"""Triplets per second, for each quality."""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator

from synthetic.camera.shot import QUALITIES
from synthetic.frames import FrameMaker, FrameOptions

_OBJECT, _SEED = "cube_v2", 1

_WARM = 2
"""Frames that compile and fill caches, and are not timed."""


def measure(seconds: float) -> Iterator[str]:
    """One line for each quality, with shadows and without; one process."""
    for quality in QUALITIES.values():
        for shadows in (False, True) if quality.shadows else (False,):
            with FrameMaker(FrameOptions(_OBJECT, _SEED, quality.name, shadows=shadows)) as maker:
                start, count = 0.0, 0
                for number in itertools.count():
                    for _ in maker.chunk(number):
                        pass
                    if number == _WARM - 1:
                        start = time.perf_counter()
                    count = number + 1 - _WARM
                    if count > 0 and time.perf_counter() - start > seconds:
                        break
                rate = count / (time.perf_counter() - start)
            yield f"{quality.name:8s} {'shadows' if shadows else 'no shadows':10s} {rate:6.2f}"
