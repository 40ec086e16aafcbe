"""What a fresh process spends: `python -m benchmarks.measure.probe OBJECT FOLDER` prints one JSON object.

FOLDER holds a rig's calibration files and `image0.npy`, … with an image for each camera. Nothing is imported
before the clock runs but the standard library.
"""

from __future__ import annotations

import json
import re
import resource
import sys
import time
from pathlib import Path


def peak_memory_mb() -> float:
    """Greatest resident memory of this process so far [MB].

    The kernel's own record where it has one: what `getrusage` says of a child includes the memory of its
    parent, of which it was a copy before it started.
    """
    status = Path("/proc/self/status")
    found = re.search(r"VmHWM:\s*(\d+) kB", status.read_text()) if status.exists() else None
    kilobytes = float(found[1]) if found else float(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
    return kilobytes / 1024


def main(name: str, folder: Path) -> None:
    """Import, make a tracker, detect; print the seconds of each and the peak memory [MB]."""
    clock = [time.perf_counter()]

    # By name, since that is what loads them.
    from tracker import CameraRig, ObjectTracker, load_object

    clock.append(time.perf_counter())
    imported = peak_memory_mb()

    import numpy as np

    rig, model = CameraRig.load(folder), load_object(name)
    images = [np.load(folder / f"image{number}.npy") for number in range(len(rig))]
    ready = time.perf_counter()
    detector = ObjectTracker(model, rig)
    detector.detect(images)
    first = time.perf_counter()
    found = {
        "import_s": clock[1] - clock[0],
        "first_s": first - ready,
        "imported_mb": imported,
        "peak_mb": peak_memory_mb(),
    }
    print(json.dumps(found))


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))
