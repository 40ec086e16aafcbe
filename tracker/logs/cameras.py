"""Which calibration belongs to a recording."""

from __future__ import annotations

import dataclasses
import os

from tracker.calibration.rig import CameraRig
from tracker.errors import CalibrationError
from tracker.logs.log import Log


def own_rig(
    path: str | os.PathLike[str], log: Log, *, correct_halved_principal_point: bool = False
) -> CameraRig:
    """The calibration in or beside a recording, in the order of its images.

    Raises:
        CalibrationError: there is none, or it does not fit the recording.
    """
    rig = log.rig
    if rig is None:
        raise CalibrationError(
            f"{os.fspath(path)}: found no calibration in or beside it, expected --calibration"
        )
    if correct_halved_principal_point:
        cameras = tuple(camera.with_halved_principal_point_corrected() for camera in rig)
        rig = dataclasses.replace(rig, cameras=cameras)
    return fitted_to(path, log, rig)


def fitted_to(path: str | os.PathLike[str], log: Log, rig: CameraRig) -> CameraRig:
    """The rig in the order of a recording's images.

    Cameras are matched by their names. Only where none of the names is known are they taken in their order.

    Raises:
        CalibrationError: cameras or sizes of images are others.
    """
    where, names = os.fspath(path), log.camera_names
    known = set(rig.names) & set(names)
    if len(rig) != len(names) or (known and set(rig.names) != set(names)):
        raise CalibrationError(
            f"{where}: found images of {', '.join(names)}, but a calibration of {', '.join(rig.names)}; "
            "expected the same cameras"
        )
    if known:
        cameras = tuple(rig[rig.names.index(name)] for name in names)
        rig = dataclasses.replace(rig, cameras=cameras)
    for one, (width, height) in zip(rig, log.image_sizes or [(c.width, c.height) for c in rig], strict=True):
        if (one.width, one.height) != (width, height):
            raise CalibrationError(
                f"{where}: found images of {width}×{height} px, but {one.name} is calibrated for "
                f"{one.width}×{one.height}"
            )
    return rig
