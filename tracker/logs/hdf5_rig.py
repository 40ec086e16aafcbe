"""The calibration inside an HDF5 log, `/camera_info`."""

from __future__ import annotations

import h5py
import numpy as np

from tracker.calibration.platform_files import MAX_ROTATION_DEVIATION
from tracker.calibration.rig import CameraRig
from tracker.errors import CalibrationError, LogError
from tracker.geometry import so3
from tracker.geometry.camera import ROTATION_TOLERANCE, Camera, rotation_deviation
from tracker.logs.hdf5_fields import has_group, read_small


def read_rig(file: h5py.File, names: tuple[str, ...], size: tuple[int, int], where: str) -> CameraRig | None:
    """The cameras' calibration, or None where the file has none.

    Args:
        file: the open log.
        names: of the cameras, in order.
        size: (width, height) [px] of the images.
        where: names the file in errors.

    Raises:
        LogError: the calibration is incomplete, damaged or impossible.
    """
    if not has_group(file, "camera_info", where):
        return None
    return CameraRig(tuple(_camera(file, name, size, where) for name in names))


def _camera(file: h5py.File, name: str, size: tuple[int, int], where: str) -> Camera:
    parts = {}
    for key, count in (("camera_matrix", 9), ("distortion_coefficients", 5), ("tf_world_to_camera", 16)):
        values = read_small(file, f"camera_info/{name}/{key}", count, where)
        if values is None:
            raise LogError(f"{where}: camera_info/{name}/{key} is missing")
        parts[key] = values
    transform = parts["tf_world_to_camera"].reshape(4, 4)
    deviation = rotation_deviation(transform[:3, :3])
    if deviation > MAX_ROTATION_DEVIATION:
        raise LogError(
            f"{where}: camera_info/{name}/tf_world_to_camera: found a 3×3 part that deviates from a "
            f"rotation by {deviation:.2g}, expected at most {MAX_ROTATION_DEVIATION:g}"
        )
    if deviation > ROTATION_TOLERANCE:  # the platform stores element-wise means of rotations
        transform[:3, :3] = so3.nearest_rotation(transform[:3, :3])
    try:
        return Camera(
            name=name,
            width=size[0],
            height=size[1],
            matrix=np.reshape(parts["camera_matrix"], (3, 3)),
            distortion=parts["distortion_coefficients"],
            camera_from_world=transform,
        )
    except CalibrationError as error:
        raise LogError(f"{where}: camera_info: {error}") from error
