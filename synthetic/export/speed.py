"""Triplets per second, for each quality and renderer."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from synthetic.camera.shot import QUALITIES
from synthetic.export.dataset import DatasetOptions, MakerFactory, Task
from synthetic.export.workers import run_tasks
from synthetic.frames import FrameOptions
from synthetic.render.choose import RENDERERS, choose_renderer
from synthetic.render.interface import RendererError

_OBJECT, _SEED = "cube_v2", 1
_MANY = 2000

_WARM = 2
"""Frames of each worker that compile and fill caches, and are not timed."""


def measure(seconds: float, workers: int) -> Iterator[str]:
    """One line for each renderer, quality, with shadows and without; writing the files is part of it."""
    for renderer in RENDERERS[1:]:
        try:
            choose_renderer(renderer)
        except RendererError as error:
            yield f"{renderer}: {error}"
            continue
        for quality in QUALITIES.values():
            for shadows in (False, True) if quality.shadows else (False,):
                rate = _rate(quality.name, renderer, shadows, seconds, workers)
                light = "shadows" if shadows else "no shadows"
                yield f"{renderer:9s} {quality.name:8s} {light:10s} {rate:6.2f}"


def _rate(quality: str, renderer: str, shadows: bool, seconds: float, workers: int) -> float:
    options = DatasetOptions(FrameOptions(_OBJECT, _SEED, quality, renderer, shadows=shadows), _MANY)
    with tempfile.TemporaryDirectory() as folder:
        factory = MakerFactory(options, Path(folder))
        tasks = [Task(number, (number,)) for number in range(_MANY)]
        results = run_tasks(factory, tasks, workers)
        try:
            for _ in range(_WARM * workers):
                next(results)
            start, count = time.perf_counter(), 0
            while time.perf_counter() - start < seconds:
                next(results)
                count += 1
            return count / (time.perf_counter() - start)
        finally:
            results.close()
