"""Read calibrations from HDF5 files of logs and of poses.

`/camera_info` has a group for each camera. The root attribute `arena` is a JSON object with the fields of an
`Arena`; without it, the arena is the default, as in the platform's files.
"""

from __future__ import annotations

import dataclasses
import json
from typing import Any

import numpy as np

from tracker.calibration.files.platform import rotation_of
from tracker.calibration.rig import CameraRig
from tracker.checks import naming
from tracker.errors import CalibrationError, LogError
from tracker.files import hdf5
from tracker.geometry.arena import Arena
from tracker.geometry.camera import COUNTS, Camera

CAMERA_DATASETS = {
    "camera_matrix": ("matrix", (3, 3)),
    "distortion_coefficients": ("distortion", (1, -1)),
    "tf_world_to_camera": ("camera_from_world", (4, 4)),
    "tf_world_to_camera_std": ("camera_from_world_std", (4, 4)),
}
"""Attribute of a Camera and shape in the file, for each dataset in a camera's group; -1: varies."""

DEVIATIONS = "tf_world_to_camera_std"
"""The dataset that may be missing."""

_ARENA = "arena"
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
        return CameraRig(tuple(read_camera(file, name, size, where) for name in names), read_arena(file))


def read_arena(file: Any) -> Arena:
    """Return the arena; LogError or CalibrationError: its attribute is damaged."""
    if _ARENA not in file.attrs:
        return Arena()
    with naming(_ARENA, LogError, ValueError, TypeError, RecursionError):
        return Arena(**json.loads(hdf5.text(file, _ARENA)))


def write_arena(file: Any, arena: Arena) -> None:
    """Write the attribute that `read_arena` reads, for an arena other than the default."""
    if arena != Arena():
        file.attrs[_ARENA] = hdf5.encoded(json.dumps(dataclasses.asdict(arena)))


def read_camera(file: Any, name: str, size: tuple[int, int], where: str) -> Camera:
    """Return one camera; LogError: something is missing or damaged; CalibrationError: it is not a camera."""
    group = f"camera_info/{name}"
    arrays: dict[str, Any] = {}
    for key, (attribute, shape) in CAMERA_DATASETS.items():
        stored = hdf5.find(file, f"{group}/{key}", where)
        if stored is None and key == DEVIATIONS:
            continue
        if stored is not None and attribute == "distortion":
            shape = stored.shape if stored.shape in _LENSES else _LENSES[0]
        values = hdf5.array(file, f"{group}/{key}", shape, "fiu", where).astype(np.float64)
        arrays[attribute] = values.ravel() if attribute == "distortion" else values
    transform = arrays["camera_from_world"]
    transform[:3, :3] = rotation_of(transform[:3, :3], f"{where}{group}/tf_world_to_camera", LogError)
    return Camera(name=name, width=size[0], height=size[1], **arrays)
