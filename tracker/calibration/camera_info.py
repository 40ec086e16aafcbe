"""Read calibrations from HDF5 files of logs and of poses: `/camera_info` has a group for each camera."""

from __future__ import annotations

from typing import Any

import numpy as np

from tracker.calibration.files.platform import rotation_of
from tracker.calibration.rig import CameraRig
from tracker.checks import naming
from tracker.errors import CalibrationError, LogError
from tracker.files import hdf5
from tracker.geometry.camera import Camera
from tracker.geometry.distortion import COUNTS

CAMERA_DATASETS = {
    "camera_matrix": ("matrix", (3, 3)),
    "distortion_coefficients": ("distortion", (1, -1)),
    "tf_world_to_camera": ("camera_from_world", (4, 4)),
    "tf_world_to_camera_std": ("camera_from_world_std", (4, 4)),
}
"""Attribute of a Camera and shape in the file, for each dataset in a camera's group; -1: varies."""

_MAY_BE_MISSING = "tf_world_to_camera_std"
_LENSES = tuple((1, count) for count in COUNTS)


def read_rig(file: Any, names: tuple[str, ...], size: tuple[int, int], where: str) -> CameraRig | None:
    """Return the calibration of cameras with images of `size` (width, height) [px]; None if there is none.

    `where` names the file in errors.

    Raises:
        LogError: the calibration is incomplete, damaged or impossible.
    """
    if not hdf5.has_group(file, "camera_info", where):
        return None
    with naming(f"{where}camera_info", LogError, CalibrationError):
        return CameraRig(tuple(read_camera(file, name, size, where) for name in names))


def read_camera(file: Any, name: str, size: tuple[int, int], where: str) -> Camera:
    """Return one camera; LogError: something is missing or damaged; CalibrationError: it is not a camera."""
    group = f"camera_info/{name}"
    arrays: dict[str, Any] = {}
    for key, (attribute, shape) in CAMERA_DATASETS.items():
        stored = hdf5.find(file, f"{group}/{key}", where)
        if stored is None and key == _MAY_BE_MISSING:
            continue
        if stored is not None and attribute == "distortion":
            shape = stored.shape if stored.shape in _LENSES else _LENSES[0]
        values = hdf5.array(file, f"{group}/{key}", shape, "fiu", where).astype(np.float64)
        arrays[attribute] = values.ravel() if attribute == "distortion" else values
    transform = arrays["camera_from_world"]
    transform[:3, :3] = rotation_of(transform[:3, :3], f"{where}{group}/tf_world_to_camera", LogError)
    return Camera(name=name, width=size[0], height=size[1], **arrays)
