"""Which calibration belongs to a recording."""

from __future__ import annotations

import dataclasses
import os

from tracker.calibration.rig import CameraRig
from tracker.errors import CalibrationError
from tracker.geometry.camera import Camera
from tracker.logs.log import Log


def fitted_to(
    path: str | os.PathLike[str],
    log: Log,
    rig: CameraRig | None = None,
    *,
    correct_halved_principal_point: bool = False,
    resize: bool = False,
) -> CameraRig:
    """The rig in the order of a recording's images.

    Cameras are matched by their names. Only where none of the names is known are they taken in their order.

    Args:
        path: names the recording in errors.
        log: the recording.
        rig: the cameras; None: those whose calibration is in or beside the recording.
        correct_halved_principal_point: whether that was halved without the quarter pixel.
        resize: scale the calibration to images of another size, but of the same shape.

    Raises:
        CalibrationError: there is no calibration, or cameras or sizes of images are others.
    """
    if rig is None:
        rig = log.rig
        if rig is None:
            raise CalibrationError(
                f"{os.fspath(path)}: found no calibration in or beside it, expected --calibration, the "
                "folder with a file of each camera, like camera60.yml"
            )
        if correct_halved_principal_point:
            cameras = tuple(camera.with_halved_principal_point_corrected() for camera in rig)
            rig = dataclasses.replace(rig, cameras=cameras)
    where, names = os.fspath(path), log.camera_names
    known = set(rig.names) & set(names)
    if len(rig) != len(names) or (known and set(rig.names) != set(names)):
        lacking = [name for name in names if name not in rig.names] if known else []
        valid = f"that of {', '.join(lacking)}, too" if lacking else "the same cameras"
        raise CalibrationError(
            f"{where}: found images of {', '.join(names)}, but a calibration of {', '.join(rig.names)}; "
            f"expected {valid}"
        )
    if known:
        cameras = tuple(rig[rig.names.index(name)] for name in names)
        rig = dataclasses.replace(rig, cameras=cameras)
    if not log.image_sizes:
        return rig
    sized = [
        sized_for(size, one, where, resize=resize) for one, size in zip(rig, log.image_sizes, strict=True)
    ]
    return dataclasses.replace(rig, cameras=tuple(sized))


def sized_for(size: tuple[int, int], camera: Camera, where: str, *, resize: bool) -> Camera:
    """The camera of images of a size (width, height) [px]; with `resize` its calibration is scaled to it.

    Raises:
        CalibrationError: the size is another one, or, with `resize`, of another shape: images were cropped.
    """
    width, height = size
    if (camera.width, camera.height) == size:
        return camera
    found = (
        f"{where}: found images of {width}×{height} px, but {camera.name} is calibrated for "
        f"{camera.width}×{camera.height}"
    )
    if abs(width * camera.height / camera.width - height) >= 1:
        raise CalibrationError(
            f"{found}, which is of another shape: expected whole images, or a calibration of what they show"
        )
    if not resize:
        raise CalibrationError(
            f"{found}; where they are the same images scaled, --resize-calibration fits it"
        )
    return camera.resized(width, height)
