"""Camera rigs of the simulated platform."""

import dataclasses
import os
from pathlib import Path

import numpy as np
import numpy.typing as npt

from synthetic.scene import direction
from tracker.calibration.rig import CameraRig
from tracker.conventions import Array, FloatArray
from tracker.errors import CalibrationError
from tracker.geometry import so3
from tracker.geometry.camera import Camera

STANDARD, PERTURBED, RANDOM = "simulation", "perturbed", "random"
"""Names of calibrations that need no files."""

ROBOTS = ("r1", "r3", "r4", "r5", "r6", "r7", "r8")
"""Robots whose recorded calibrations can be named, where the recorded data are available."""

RECORDED = Path(os.environ.get("TRACKER_REAL_DATA", Path(__file__).resolve().parents[3] / "shared" / "real"))
"""Folder of recorded data; its `calibration/robots` holds a file like r1_camera60.yml for each camera."""

KNOWN = (STANDARD, PERTURBED, RANDOM, *ROBOTS)
"""All names of calibrations; anything else is a folder."""

_PERTURBED_STREAM, _RANDOM_STREAM = 77, 78

_DISTORTIONS = (
    (-0.236, 0.112, -0.0012, 0.0003, -0.041),
    (-0.233, 0.106, -0.0021, 0.0001, -0.034),
    (-0.239, 0.121, -0.0008, -0.0002, -0.052),
)
_FOCALS_PX = ((294.2, 295.9), (293.1, 294.6), (295.0, 296.3))
_PRINCIPAL_POINTS_PX = ((138.4, 136.1), (132.7, 139.8), (140.2, 133.5))
_AZIMUTHS_DEG = (60, 180, 300)
_GAPS_DEG = np.array([30.0, 270.0, 150.0])
"""Middles of the gaps between the fingers' bases, for recorded cameras 60, 180 and 300."""

_POSITIONS_M = ((0.345, 0.392), (0.328, 0.408), (0.339, 0.398))
_TARGETS_M = ((0.004, -0.006, 0.012), (-0.005, 0.002, 0.004), (0.002, 0.007, 0.008))


def default_cameras(width: int = 270) -> tuple[Camera, ...]:
    """Return three cameras, 60, 180 and 300 degrees around the arena, with square images of `width` pixels.

    They differ a little from each other, as on a real platform. Their standard deviations are zero: images
    rendered through them obey them exactly.
    """
    return tuple(_camera(index).resized(width, width) for index in range(len(_AZIMUTHS_DEG)))


def _camera(index: int) -> Camera:
    azimuth = np.radians(_AZIMUTHS_DEG[index])
    radius, height = _POSITIONS_M[index]
    position = radius * direction(azimuth) + [0.0, 0.0, height]
    (fx, fy), (cx, cy) = _FOCALS_PX[index], _PRINCIPAL_POINTS_PX[index]
    return Camera(
        name=f"camera{_AZIMUTHS_DEG[index]}",
        width=270,
        height=270,
        matrix=np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]),
        distortion=np.array(_DISTORTIONS[index]),
        camera_from_world=looking(position, _TARGETS_M[index]),
        camera_from_world_std=np.zeros((4, 4)),
    )


def looking(position: Array, target: npt.ArrayLike) -> FloatArray:
    """Return camera_from_world (4, 4) of an upright camera at `position` that looks at `target` (3,) [m]."""
    forward = np.asarray(target) - position
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    return so3.transform(rotation, -rotation @ position)


def standard_rig() -> CameraRig:
    """Return the simulated platform's cameras, 540×540, at 60, 180 and 300 degrees."""
    return CameraRig(default_cameras(540))


def choose_rig(calibration: str, seed: int) -> CameraRig:
    """Return the rig that `calibration` names.

    Args:
        calibration: `simulation`; `perturbed`: another platform, built a little differently; `random`:
            cameras somewhere around the arena; `r1`, `r3` … `r8`: that robot's rig of the recorded data; or
            a folder with one platform file for each camera.
        seed: seed of `perturbed` and `random`.

    Raises:
        CalibrationError: the files are missing or malformed.
    """
    if calibration == STANDARD:
        return standard_rig()
    if calibration == PERTURBED:
        return perturbed_rig(np.random.default_rng([seed, _PERTURBED_STREAM]))
    if calibration == RANDOM:
        return random_rig(np.random.default_rng([seed, _RANDOM_STREAM]))
    if Path(calibration).exists():
        # This arena is rendered, whatever the folder's file says.
        return dataclasses.replace(CameraRig.load(calibration), arena=standard_rig().arena)
    if calibration not in ROBOTS:
        raise CalibrationError(
            f"calibration {calibration}: found no such folder, expected one, or one of {', '.join(KNOWN)}"
        )
    folder = RECORDED / "calibration" / "robots"
    if not folder.is_dir():
        raise CalibrationError(
            f"calibration {calibration}: found no folder {folder}, expected recorded data there, or where "
            "TRACKER_REAL_DATA says"
        )
    return CameraRig.load(folder, pattern=f"{calibration}_*.yml")


def perturbed_rig(rng: np.random.Generator) -> CameraRig:
    """Draw cameras that differ from the standard ones about as much as real platforms do from each other."""
    rig = standard_rig()
    return dataclasses.replace(rig, cameras=tuple(_perturbed(camera, rng) for camera in rig))


def _perturbed(camera: Camera, rng: np.random.Generator) -> Camera:
    matrix = camera.matrix.copy()
    matrix[(0, 1), (0, 1)] *= rng.normal(1.0, 0.006) * rng.normal(1.0, 0.002, 2)
    matrix[:2, 2] += rng.normal(0.0, 5.0, 2) * camera.height / 540
    rotation = so3.exp(rng.normal(0.0, 0.015, 3)) @ camera.camera_from_world[:3, :3]
    position = camera.position + rng.normal(0.0, 0.008, 3)
    return dataclasses.replace(
        camera,
        matrix=matrix,
        distortion=camera.distortion * rng.normal(1.0, 0.04, 5),
        camera_from_world=so3.transform(rotation, -rotation @ position),
    )


def random_rig(rng: np.random.Generator) -> CameraRig:
    """Draw three cameras around the arena, 540×540, which obey their calibration exactly.

    Lenses vary like the 21 lenses of seven robots (`scripts/fit_rigs.py`). Those robots share one design;
    distances vary three times as much here, rolls and where cameras look about twice, elevations a little
    more, and each camera is anywhere in its gap between the bases of two fingers, which those robots have at
    90, 210 and 330 degrees.
    """
    azimuths = _GAPS_DEG + rng.uniform(-25.0, 25.0, 3)
    names = (f"camera{nominal}" for nominal in _AZIMUTHS_DEG)
    cameras = [_random(name, azimuth, rng) for name, azimuth in zip(names, azimuths, strict=True)]
    return CameraRig(tuple(cameras)).resized(540, 540)


def _random(name: str, azimuth_deg: float, rng: np.random.Generator) -> Camera:
    """Draw one camera at 270×270."""
    elevation, azimuth = np.radians(rng.uniform(42.0, 64.0)), np.radians(azimuth_deg)
    distance = float(np.clip(rng.normal(0.534, 0.034), 0.46, 0.61))
    target = np.array([*rng.normal(0.0, 0.02, 2), 0.0])
    away = direction(azimuth, elevation)
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    rotation = so3.exp(np.radians([0.0, 0.0, rng.normal(0.0, 1.0)])) @ np.stack(
        [right, np.cross(-away, right), -away]
    )
    camera_from_world = so3.transform(rotation, -rotation @ (target + distance * away))
    fx = rng.normal(295.0, 1.7)
    matrix = np.eye(3)
    matrix[0, 0], matrix[1, 1] = fx, fx * rng.normal(1.0044, 0.0015)
    matrix[:2, 2] = 134.5 + rng.normal([6.2, 4.1], [3.3, 5.4])
    # k1, k2 and k3 are correlated: the data determine one combination far better than all three.
    more = 0.039 * float(np.clip(rng.normal(), -2.0, 2.0))
    k1, k3 = -0.237 - 0.153 * more + rng.normal(0.0, 0.004), -0.086 - 2.06 * more + rng.normal(0.0, 0.015)
    p1, p2 = rng.normal([-0.0024, 0.0001], [0.0007, 0.0002])
    distortion = np.array([k1, 0.128 + more, p1, p2, k3])
    return Camera(name, 270, 270, matrix, distortion, camera_from_world, np.zeros((4, 4)))


def sized(rig: CameraRig, height: int) -> CameraRig:
    """Return the rig with images scaled to `height` [px] and widths kept even for the colour mosaic."""
    widths = [2 * round(camera.width * height / camera.height / 2) for camera in rig]
    cameras = tuple(camera.resized(width, height) for camera, width in zip(rig, widths, strict=True))
    return dataclasses.replace(rig, cameras=cameras)
