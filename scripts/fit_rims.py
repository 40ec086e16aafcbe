"""Measure how far within the nominal edges the faces of recorded objects end.

    python scripts/fit_rims.py REAL_FOLDER

REAL_FOLDER holds `pose/OBJECT` with a triplet and its calibration. A wrong rim makes cameras disagree: the
pose from all cameras but one, projected into the last, misses there, and a single camera estimates the object
too near or too far. For each width of the rim, taken as exact, the script prints the miss, and how much
farther away a single camera puts the object than all cameras together.

The last line of each triplet is the rim estimated by all cameras together, whatever the object's file states:
0.3 mm for cube_v1, 0.6 mm for cube_v2 and 0.9 mm for the cuboid. `tracker/objects/data` states values within
one standard deviation of these, with a standard deviation for other objects of the kind.
"""

import dataclasses
import sys
from pathlib import Path

import numpy as np

import tracker
from benchmarks.data.recorded import triplets
from benchmarks.measure.recorded import third_camera_miss, without_each
from tracker.conventions import Image
from tracker.objects.model import LEAST_RIM_STD
from tracker.pose.fit import Fit

WIDTHS = np.arange(0.0, 0.00105, 0.0001)

UNKNOWN = 3e-4, 6e-4
"""Weak prior of the rim: mean and standard deviation [m]."""


def measure(
    detector: tracker.ObjectTracker, images: list[Image], width: float
) -> tuple[list[float], list[float]]:
    """Return misses in each camera [px], and how much farther away each puts the object on its own [mm]."""
    model = dataclasses.replace(detector.model, rim=width, rim_std=LEAST_RIM_STD)
    exact = tracker.ObjectTracker(model, detector.rig, detector.colors)
    whole = exact.detect(images).object_pose
    misses, farther = [], []
    for camera, two, own in without_each(exact, images):
        misses.append(third_camera_miss(camera, model, two, own)["px"])
        if own is not None and whole is not None:
            away = whole.position - camera.position
            farther.append(1e3 * float((own.position - whole.position) @ away / np.linalg.norm(away)))
    return misses, farther


def main(real: Path) -> None:
    """Print the table of each recorded triplet."""
    for name, group, detector, images in triplets(real):
        print(f"{name} ({group})")
        for width in WIDTHS:
            misses, farther = measure(detector, [image.image for image in images], float(width))
            rms = float(np.sqrt(np.nanmean(np.square(misses))))
            each = " ".join(f"{miss:5.2f}" for miss in misses)
            alone = " ".join(f"{more:6.1f}" for more in farther)
            print(f"  rim {1e3 * width:.1f} mm: miss {rms:.2f} px ({each}), alone farther by {alone} mm")
        model = dataclasses.replace(detector.model, rim=UNKNOWN[0], rim_std=UNKNOWN[1])
        asking = tracker.ObjectTracker(model, detector.rig, detector.colors)
        fit = asking.fit([image.image for image in images])
        if isinstance(fit, Fit):
            print(f"  rim found by all cameras: {1e3 * fit.end.rim:.2f} ± {1e3 * fit.end.rim_std:.2f} mm")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
