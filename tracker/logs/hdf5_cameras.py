"""The cameras in an HDF5 file, of the platform's logs and of poses: `/camera_names` and `/camera_info`."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from tracker.calibration.platform_files import MAX_ROTATION_DEVIATION
from tracker.calibration.rig import CameraRig
from tracker.conventions import FloatArray
from tracker.errors import CalibrationError, LogError
from tracker.files import cannot_read, hdf5
from tracker.geometry import so3
from tracker.geometry.camera import ROTATION_TOLERANCE, Camera, rotation_deviation
from tracker.geometry.distortion import COUNTS

CAMERA_DATASETS = {
    "camera_matrix": ("matrix", (3, 3)),
    "distortion_coefficients": ("distortion", (1, -1)),
    "tf_world_to_camera": ("camera_from_world", (4, 4)),
    "tf_world_to_camera_std": ("camera_from_world_std", (4, 4)),
}
"""Attribute of a Camera, and shape in the file, of each dataset in a camera's group; -1: of its lens."""

_MAY_BE_MISSING = "tf_world_to_camera_std"
_LENSES = tuple((1, count) for count in COUNTS)
_MAX_NAME = 64
_MAX_HEAP = 1 << 20
_REFERENCE = struct.Struct("<IQI")  # length, address of the heap, number in it
_HEAP_HEAD = struct.Struct("<4sB3xQ")
_OBJECT_HEAD = struct.Struct("<HH4xQ")


def read_rig(file: Any, names: tuple[str, ...], size: tuple[int, int], where: str) -> CameraRig | None:
    """The cameras' calibration, or None where the file has none.

    Args:
        file: the open file.
        names: of the cameras, in order.
        size: (width, height) [px] of the images.
        where: names the file in errors.

    Raises:
        LogError: the calibration is incomplete, damaged or impossible.
    """
    if not hdf5.has_group(file, "camera_info", where):
        return None
    try:
        return CameraRig(tuple(read_camera(file, name, size, where) for name in names))
    except CalibrationError as error:
        raise LogError(f"{where}camera_info: {error}") from error


def read_camera(file: Any, name: str, size: tuple[int, int], where: str) -> Camera:
    """One camera; see `read_rig`.

    Raises:
        LogError: something is missing or damaged.
        CalibrationError: it cannot be a camera.
    """
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
    _mend(arrays["camera_from_world"], f"{where}{group}/tf_world_to_camera")
    return Camera(name=name, width=size[0], height=size[1], **arrays)


def _mend(transform: FloatArray, what: str) -> None:
    """Make the 3×3 part a rotation; LogError where it is far from one."""
    deviation = rotation_deviation(transform[:3, :3])
    if deviation > MAX_ROTATION_DEVIATION:
        raise LogError(
            f"{what}: found a 3×3 part that deviates from a rotation by {deviation:.2g}, expected at most "
            f"{MAX_ROTATION_DEVIATION:g}"
        )
    if deviation > ROTATION_TOLERANCE:  # the platform stores element-wise means of rotations
        transform[:3, :3] = so3.nearest_rotation(transform[:3, :3])


def read_names(field: h5py.Dataset, count: int, path: Path) -> tuple[str, ...]:
    """The names in the field `camera_names`; LogError if they are not `count` different ones.

    Strings of variable length lie in a heap of the file, and in a damaged heap the HDF5 library reads
    beyond its memory: it ends the process. Therefore these few bytes are read here.
    """
    what = f"{path}: camera_names"
    with hdf5.faults_as_log_errors(what):
        kind = field.id.get_type()
        text = isinstance(kind, h5py.h5t.TypeStringID)
        fixed = text and not kind.is_variable_str()
        variable = (text and not fixed) or isinstance(kind, h5py.h5t.TypeVlenID)
        # As the type of a reference h5py gives its size in memory.
        size = _REFERENCE.size if variable else int(kind.get_size())
        offset = field.id.get_offset()
        if field.shape != (count,) or not (fixed or variable) or size > _MAX_NAME or offset is None:
            raise LogError(f"found {field.dtype} of shape {field.shape}, expected {count} names")
        if field.id.get_storage_size() != count * size:
            raise LogError(f"found {field.id.get_storage_size()} bytes, expected {count * size}")
    try:
        data = _bytes_at(path, offset, count * size)
        parts = [data[k * size : (k + 1) * size] for k in range(count)]
        found = parts if fixed else [_from_heap(path, part) for part in parts]
        names = tuple(name.rstrip(b"\0").decode("ascii") for name in found)
    except (struct.error, UnicodeDecodeError, LogError) as error:
        raise LogError(f"{what}: found damaged names ({error}), expected {count}") from error
    if len(set(names)) < count or not all(name.isidentifier() for name in names):
        raise LogError(f"{what}: found {', '.join(names)!r}, expected {count} different names")
    return names


def _from_heap(path: Path, reference: bytes) -> bytes:
    """The string that a reference means."""
    length, address, wanted = _REFERENCE.unpack(reference)
    if length > _MAX_NAME:
        raise LogError(f"a name of {length} bytes")
    magic, version, size = _HEAP_HEAD.unpack(_bytes_at(path, address, _HEAP_HEAD.size))
    if magic != b"GCOL" or version != 1 or size > _MAX_HEAP:
        raise LogError("no heap of names")
    heap = _bytes_at(path, address, size)
    at = _HEAP_HEAD.size
    while at + _OBJECT_HEAD.size <= len(heap):
        number, _, stored = _OBJECT_HEAD.unpack_from(heap, at)
        at += _OBJECT_HEAD.size
        if number == wanted and number and length <= stored:
            return heap[at : at + length]
        if number == 0:  # what is free
            break
        at += -(-stored // 8) * 8
    raise LogError("a name that the heap does not hold")


def _bytes_at(path: Path, offset: int, size: int) -> bytes:
    try:
        with path.open("rb") as file:
            if offset >= file.seek(0, 2):
                raise LogError("beyond the end of the file")
            file.seek(offset)
            return file.read(size)
    except OSError as error:
        raise cannot_read(path, error) from error
