"""Start-up, compilation and memory of fresh processes.

`python -m benchmarks.measure.start_up OBJECT FOLDER` measures one process and prints JSON. FOLDER holds
a rig's calibration files and `image0.npy`, … with an image for each camera. Only the standard library is
imported before the clock starts.
"""

import json
import os
import re
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]

OBJECT, PROCESSES = "cube_v2", 5


def measure_start_up() -> list[dict[str, Any]]:
    """Return rows with `group`, `object`, `seconds`, `megabytes`.

    They are for one process that compiles, and medians over several that do not.

    Raises:
        TrackerError: a process failed.
    """
    import numpy as np

    from benchmarks.data.scenes import rig
    from synthetic.frames import frames

    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        rig().save(folder)
        (frame,) = frames(OBJECT, 1, 31, rig=rig(), empty=0.0)
        for number, image in enumerate(frame.images):
            np.save(folder / f"image{number}.npy", image)
        cache = folder / "cache"
        compiling = _started(OBJECT, folder, cache)
        cached = [_started(OBJECT, folder, cache) for _ in range(PROCESSES)]
    usual = {key: statistics.median(found[key] for found in cached) for key in compiling}
    figures = {
        "import tracker": (usual["import_s"], usual["imported_mb"]),
        "first detection, kernels in the cache": (usual["first_s"], usual["peak_mb"]),
        "first detection, kernels to be compiled": (compiling["first_s"], compiling["peak_mb"]),
    }
    return [
        {"group": group, "object": OBJECT, "seconds": seconds, "megabytes": megabytes}
        for group, (seconds, megabytes) in figures.items()
    ]


def _started(name: str, folder: Path, cache: Path) -> dict[str, float]:
    from tracker.errors import TrackerError

    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH", "")]))
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.measure.start_up", name, str(folder)],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": path, "NUMBA_CACHE_DIR": str(cache)},
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        raise TrackerError(f"a process that was to be measured failed: {done.stderr.strip()}")
    found: dict[str, float] = json.loads(done.stdout)
    return found


def peak_memory_mb() -> float:
    """Return the largest resident memory of this process so far [MB].

    Uses the kernel's own record if there is one: for a child, `getrusage` includes the memory of its parent,
    since it starts as a copy of it.
    """
    status = Path("/proc/self/status")
    found = re.search(r"VmHWM:\s*(\d+) kB", status.read_text()) if status.exists() else None
    kilobytes = float(found[1]) if found else float(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
    return kilobytes * 1024 / 1e6


def main(name: str, folder: Path) -> None:
    """Import, make a tracker, detect; print the time of each step [s] and the peak memory [MB]."""
    start = time.perf_counter()

    # Import them by name, since that is what loads these modules.
    from tracker import CameraRig, ObjectTracker, load_object

    imported_at, imported = time.perf_counter(), peak_memory_mb()

    import numpy as np

    rig, model = CameraRig.load(folder), load_object(name)
    images = [np.load(folder / f"image{number}.npy") for number in range(len(rig))]
    ready = time.perf_counter()
    ObjectTracker(model, rig).detect(images)
    found = {
        "import_s": imported_at - start,
        "first_s": time.perf_counter() - ready,
        "imported_mb": imported,
        "peak_mb": peak_memory_mb(),
    }
    print(json.dumps(found))


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))
