"""Measure the spread of recorded calibrations, for the random rigs of `synthetic.camera.rigs`.

    python scripts/fit_rigs.py REAL_FOLDER

REAL_FOLDER holds `calibration/robots/rN_camera*.yml`. Prints mean and standard deviation of the parameters of
random cameras, at 270 × 270.
"""

import sys
from pathlib import Path

import numpy as np

from tracker.calibration.rig import CameraRig
from tracker.geometry.camera import Camera

NAMES = (
    "distance to where it looks [m]",
    "elevation above that [deg]",
    "x of where it looks [m]",
    "y of where it looks [m]",
    "roll about its axis [deg]",
    "fx [px]",
    "fy / fx",
    "cx - 134.5 [px]",
    "cy - 134.5 [px]",
    *("k1", "k2", "p1", "p2", "k3"),
    "stated deviation of translations [mm]",
    "stated deviation of rotations [mrad]",
)


def figures(camera: Camera) -> list[float]:
    """Return the values named by NAMES for one camera."""
    rotation, position = camera.camera_from_world[:3, :3], camera.position
    axis = rotation[2]
    distance = -position[2] / axis[2]
    target = position + distance * axis
    assert camera.camera_from_world_std is not None
    std = camera.camera_from_world_std
    return [
        distance,
        np.degrees(np.arcsin(-axis[2])),
        *target[:2],
        np.degrees(np.arctan2(rotation[0, 2], -rotation[1, 2])),
        camera.matrix[0, 0],
        camera.matrix[1, 1] / camera.matrix[0, 0],
        *(camera.matrix[:2, 2] - 134.5),
        *camera.distortion,
        1e3 * float(std[:3, 3].mean()),
        # The mean square of the nine elements is 2/3 of the variance of a rotation about one axis.
        1e3 * float(np.sqrt(1.5 * (std[:3, :3] ** 2).mean())),
    ]


def main(real: Path) -> None:
    """Print the statistics over all cameras."""
    folder = real / "calibration" / "robots"
    robots = sorted({path.name.split("_")[0] for path in folder.glob("r*_camera*.yml")})
    rigs = [CameraRig.load(folder, pattern=f"{robot}_*.yml") for robot in robots]
    rows = np.array([figures(camera) for rig in rigs for camera in rig])
    print(f"{len(rows)} cameras of {', '.join(robots)}")
    for name, column in zip(NAMES, rows.T, strict=True):
        spread = f"deviation {column.std():.3g}, {column.min():.5g} to {column.max():.5g}"
        print(f"  {name}: mean {column.mean():.5g}, {spread}")
    k1, k2, k3 = rows[:, 9], rows[:, 10], rows[:, 13]
    print(f"  k1 and k3 for each 1 of k2: {np.polyfit(k2, k1, 1)[0]:.3f}, {np.polyfit(k2, k3, 1)[0]:.3f}")
    angles = [sorted(np.degrees(np.arctan2(*camera.position[1::-1])) for camera in rig) for rig in rigs]
    gaps = np.diff(np.array([[*row, row[0] + 360] for row in angles]))
    print(f"  angles between neighbours [deg]: {gaps.min():.1f} to {gaps.max():.1f}")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
