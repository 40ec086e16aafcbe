"""Read calibrations from HDF5 files of logs and of poses.

`/camera_info` has a group for each camera. The root attribute `arena` is a JSON object with the fields of an
`Arena`; without it, the arena is the default, as in the platform's files.
"""

import dataclasses
import json
from typing import Any

import numpy as np

from tracker.calibration.files import rotation_of
from tracker.checks import naming
from tracker.errors import LogError
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

_ARENA = "arena"
_LENSES = tuple((1, count) for count in COUNTS)


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


def read_camera(file: Any, name: str, size: tuple[int, int]) -> Camera:
    """Return one camera, whose images have `size` (width, height) [px].

    LogError: something is missing or damaged; CalibrationError: it is not a camera.
    """
    group = f"camera_info/{name}"
    arrays: dict[str, Any] = {}
    for key, (attribute, shape) in CAMERA_DATASETS.items():
        stored = hdf5.find(file, f"{group}/{key}")
        if stored is None and attribute == "camera_from_world_std":
            continue
        if stored is not None and attribute == "distortion":
            shape = stored.shape if stored.shape in _LENSES else _LENSES[0]
        values = hdf5.array(file, f"{group}/{key}", shape, "fiu").astype(np.float64)
        arrays[attribute] = values.ravel() if attribute == "distortion" else values
    transform = arrays["camera_from_world"]
    transform[:3, :3] = rotation_of(transform[:3, :3], f"/{group}/tf_world_to_camera", LogError)
    return Camera(name=name, width=size[0], height=size[1], **arrays)
