"""Which cameras look at the simulated platform."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from tracker.calibration.rig import CameraRig
from tracker.errors import CalibrationError
from tracker.geometry import so3
from tracker.geometry.camera import Camera

STANDARD, PERTURBED = "simulation", "perturbed"
"""Names of calibrations that need no files."""

_PERTURBED_STREAM = 77

_DISTORTIONS = (
    (-0.236, 0.112, -0.0012, 0.0003, -0.041),
    (-0.233, 0.106, -0.0021, 0.0001, -0.034),
    (-0.239, 0.121, -0.0008, -0.0002, -0.052),
)
_FOCALS_PX = ((294.2, 295.9), (293.1, 294.6), (295.0, 296.3))
_PRINCIPAL_POINTS_PX = ((138.4, 136.1), (132.7, 139.8), (140.2, 133.5))
_AZIMUTHS_DEG = (60, 180, 300)
_POSITIONS_M = ((0.345, 0.392), (0.328, 0.408), (0.339, 0.398))
_TARGETS_M = ((0.004, -0.006, 0.012), (-0.005, 0.002, 0.004), (0.002, 0.007, 0.008))


def default_cameras(width: int = 270) -> tuple[Camera, ...]:
    """Three cameras, 60, 180 and 300 degrees around the arena, with square images of `width` pixels.

    They differ a little from each other, as on a real platform, and their standard deviations are zero:
    images rendered through them obey them exactly.
    """
    return tuple(_camera(index).resized(width, width) for index in range(len(_AZIMUTHS_DEG)))


def _camera(index: int) -> Camera:
    azimuth = np.radians(_AZIMUTHS_DEG[index])
    radius, height = _POSITIONS_M[index]
    position = np.array([radius * np.cos(azimuth), radius * np.sin(azimuth), height])
    forward = np.asarray(_TARGETS_M[index]) - position
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    camera_from_world = np.eye(4)
    camera_from_world[:3, :3] = np.stack([right, np.cross(forward, right), forward])
    camera_from_world[:3, 3] = -camera_from_world[:3, :3] @ position

    (fx, fy), (cx, cy) = _FOCALS_PX[index], _PRINCIPAL_POINTS_PX[index]
    return Camera(
        name=f"camera{_AZIMUTHS_DEG[index]}",
        width=270,
        height=270,
        matrix=np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]),
        distortion=np.array(_DISTORTIONS[index]),
        camera_from_world=camera_from_world,
        camera_from_world_std=np.zeros((4, 4)),
    )


def standard_rig() -> CameraRig:
    """The simulated platform's cameras, 540×540, at 60, 180 and 300 degrees."""
    return CameraRig(default_cameras(540))


def choose_rig(calibration: str, seed: int) -> CameraRig:
    """The rig that `calibration` names.

    Args:
        calibration: `simulation`; `perturbed`: another platform, built a little differently, drawn from
            `seed`; or a folder with one platform file for each camera.
        seed: for `perturbed`.

    Raises:
        CalibrationError: the files are missing or malformed.
    """
    if calibration == STANDARD:
        return standard_rig()
    if calibration == PERTURBED:
        return perturbed_rig(np.random.default_rng([seed, _PERTURBED_STREAM]))
    if not Path(calibration).exists():
        raise CalibrationError(
            f"calibration {calibration}: found no such folder, expected one, or {STANDARD} or {PERTURBED}"
        )
    return CameraRig.load(calibration)


def perturbed_rig(rng: np.random.Generator) -> CameraRig:
    """Cameras that differ from the standard ones about as much as real platforms do from each other."""
    rig = standard_rig()
    return dataclasses.replace(rig, cameras=tuple(_perturbed(camera, rng) for camera in rig))


def _perturbed(camera: Camera, rng: np.random.Generator) -> Camera:
    matrix = camera.matrix.copy()
    matrix[(0, 1), (0, 1)] *= rng.normal(1.0, 0.006) * rng.normal(1.0, 0.002, 2)
    matrix[:2, 2] += rng.normal(0.0, 5.0, 2) * camera.height / 540
    transform = np.eye(4)
    transform[:3, :3] = so3.exp(rng.normal(0.0, 0.015, 3)) @ camera.camera_from_world[:3, :3]
    position = camera.position + rng.normal(0.0, 0.008, 3)
    transform[:3, 3] = -transform[:3, :3] @ position
    return dataclasses.replace(
        camera,
        matrix=matrix,
        distortion=camera.distortion * rng.normal(1.0, 0.04, 5),
        camera_from_world=transform,
    )


def sized(rig: CameraRig, height: int) -> CameraRig:
    """The rig of pictures scaled to `height` [px], whose widths stay even for the colour mosaic."""
    widths = [2 * round(camera.width * height / camera.height / 2) for camera in rig]
    cameras = tuple(camera.resized(width, height) for camera, width in zip(rig, widths, strict=True))
    return dataclasses.replace(rig, cameras=cameras)
