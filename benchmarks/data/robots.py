"""Calibrations of real robots, from the recorded data where there are any."""

from __future__ import annotations

import dataclasses
import functools
import os
from pathlib import Path

import numpy as np

from benchmarks.data.fingerprint import ROOT
from synthetic.camera.rigs import ROBOTS, choose_rig, sized
from tracker.calibration.rig import CameraRig
from tracker.geometry.camera import Camera


def real_folder(path: Path | None = None) -> Path | None:
    """The folder of recorded data that was named, or the usual one; None where there is none."""
    folder = Path(path or os.environ.get("TRACKER_REAL_DATA") or ROOT.parent / "shared" / "real")
    return folder if folder.is_dir() else None


@functools.cache
def robots() -> tuple[CameraRig, ...]:
    """The cameras of all recorded robots.

    Raises:
        CalibrationError: there are no recorded data.
    """
    return tuple(choose_rig(name, 0) for name in ROBOTS)


def another(rig: CameraRig, rng: np.random.Generator) -> CameraRig:
    """As far from the true cameras as those of one recorded robot are from those of another."""
    one, other = (
        sized(robots()[k], rig[0].height) for k in rng.choice(len(robots()), 2, replace=False).tolist()
    )
    return dataclasses.replace(rig, cameras=tuple(map(_moved, rig, one, other)))


def _moved(camera: Camera, one: Camera, other: Camera) -> Camera:
    move = other.camera_from_world @ np.linalg.inv(one.camera_from_world)
    return dataclasses.replace(
        camera,
        matrix=camera.matrix + other.matrix - one.matrix,
        distortion=camera.distortion + other.distortion - one.distortion,
        camera_from_world=move @ camera.camera_from_world,
        camera_from_world_std=other.camera_from_world_std,
    )
