"""Which cameras look at the simulated platform."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from synthetic.simple_rig import default_cameras
from tracker.calibration.rig import CameraRig
from tracker.errors import CalibrationError
from tracker.geometry import so3
from tracker.geometry.camera import Camera

STANDARD, PERTURBED = "simulation", "perturbed"
"""Names of calibrations that need no files."""

_PERTURBED_STREAM = 77


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
