"""Data recorded on real platforms: hand-labelled images, triplets with their calibrations, and robots."""

import dataclasses
import functools
import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import tracker
from benchmarks.data.fingerprint import ROOT
from synthetic.camera.rigs import ROBOTS, choose_rig, sized
from tracker.calibration.rig import CameraRig
from tracker.color_learning.labelled import LabelledImage, read_labelled
from tracker.geometry.camera import Camera

POSED = ("cube_v1", "cube_v2", "cuboid_2x2x8_v2")
SEGMENTED = ("cube_v1", "cube_v2", "cube_v3", "cuboid_2x2x8_v2")
CORRECTED = "principal point corrected"
"""Group of a triplet whose files are read with this correction; there is also a group without it."""


def labelled_images(real: Path, name: str) -> list[LabelledImage]:
    """Return all labelled images of one object."""
    folders = [real / kind / name for kind in ("pose", "segmentation")]
    return [image for folder in folders if folder.is_dir() for image in read_labelled(folder)]


def triplet(real: Path, name: str, *, corrected: bool) -> tuple[tracker.ObjectTracker, list[LabelledImage]]:
    """Return a tracker for the object's triplet, and its images in the cameras' order."""
    folder = real / "pose" / name
    images = {int(i.name.split("camera")[1]): i for i in read_labelled(folder)}
    rig = tracker.CameraRig.load(folder, correct_halved_principal_point=corrected)
    return tracker.ObjectTracker(tracker.load_object(name), rig), [images[c] for c in (60, 180, 300)]


def triplets(real: Path) -> Iterator[tuple[str, str, tracker.ObjectTracker, list[LabelledImage]]]:
    """Yield every recorded triplet: object, group (CORRECTED or empty), a tracker for it, and its images."""
    for name in POSED:
        for corrected in (False, True) if name == "cuboid_2x2x8_v2" else (False,):
            yield name, CORRECTED if corrected else "", *triplet(real, name, corrected=corrected)


def real_folder(path: Path | None = None) -> Path | None:
    """Return the given folder of recorded data, or else the default one; None if it does not exist."""
    folder = Path(path or os.environ.get("TRACKER_REAL_DATA") or ROOT.parent / "shared" / "real")
    return folder if folder.is_dir() else None


@functools.cache
def robots() -> tuple[CameraRig, ...]:
    """Return the cameras of all recorded robots.

    Raises:
        CalibrationError: there are no recorded data.
    """
    return tuple(choose_rig(name, 0) for name in ROBOTS)


def another(rig: CameraRig, rng: np.random.Generator) -> CameraRig:
    """Return a rig that differs from the true one as much as two recorded robots' rigs differ."""
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
