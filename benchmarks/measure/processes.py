"""Start-up, compilation and memory, measured in fresh processes."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

import tracker
from benchmarks.measure.timed_scenes import TimedScene
from tracker.errors import TrackerError

ROOT = Path(__file__).resolve().parents[2]


def process_rows(
    name: str, rig: tracker.CameraRig, scene: TimedScene, processes: int
) -> list[dict[str, Any]]:
    """Rows of the part `start-up`: of one process that compiles, and medians of `processes` that do not.

    Raises:
        TrackerError: a process failed.
    """
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        rig.save(folder)
        for number, image in enumerate(scene.images):
            np.save(folder / f"image{number}.npy", np.asarray(image))
        cache = folder / "cache"
        compiling = _probe(name, folder, cache)
        cached = [_probe(name, folder, cache) for _ in range(processes)]
    median = {key: float(np.median([row[key] for row in cached])) for key in compiling}
    figures = {
        "import tracker": {"seconds": median["import_s"], "megabytes": median["imported_mb"]},
        "first detection, kernels in the cache": {
            "seconds": median["first_s"],
            "megabytes": median["peak_mb"],
        },
        "first detection, kernels to be compiled": {
            "seconds": compiling["first_s"],
            "megabytes": compiling["peak_mb"],
        },
    }
    about = {"part": "start-up", "object": name}
    return [{**about, "group": group, "n": processes, **row} for group, row in figures.items()]


def kernels_in(cache: Path) -> dict[str, str]:
    """Environment of a process that keeps compiled kernels in a folder of their own."""
    return {"NUMBA_CACHE_DIR": str(cache)}


def _probe(name: str, folder: Path, cache: Path) -> dict[str, float]:
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH", "")]))
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.measure.probe", name, str(folder)],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": path, **kernels_in(cache)},
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        raise TrackerError(f"a process that was to be measured failed: {done.stderr.strip()}")
    found: dict[str, float] = json.loads(done.stdout)
    return found
