"""Recordings in other formats than they came in."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2

from tracker.calibration.rig import CameraRig
from tracker.errors import LogError
from tracker.files import told_as, whole_file
from tracker.logs.hdf5_writer import Hdf5LogWriter
from tracker.logs.log import Log

Progress = Callable[[int], None]
"""Takes how many more frames are done."""


def write_hdf5(path: Path, log: Log, rig: CameraRig, progress: Progress) -> None:
    """Write frames as one of the platform's HDF5 logs, whole or not at all; what is raw stays so."""
    has_poses = any(frame.recorded_pose is not None for frame in log)
    with (
        told_as(LogError, path),
        whole_file(path) as temporary,
        Hdf5LogWriter(temporary, rig, poses=has_poses, flush_every=0, name=path) as writer,
    ):
        for frame in log:
            images = frame.images if frame.raw is None else frame.raw
            writer.append(images, frame.timestamp, frame.camera_timestamps, frame.recorded_pose)
            progress(1)


def write_folder(path: Path, log: Log, rig: CameraRig, progress: Progress) -> None:
    """Write frames as a folder of PNG files for each camera, named by their stamps, with the calibration.

    The folder appears when all is written. A picture that a recorder repeated is there once.
    """
    with told_as(LogError, path), whole_file(path) as folder:
        for name in rig.names:
            (folder / name).mkdir(parents=True)
        rig.save(folder)
        for frame in log:
            for name, image, stamp in zip(rig.names, frame.images, frame.camera_timestamps, strict=True):
                if image is None:
                    continue
                file = folder / name / f"{stamp:.9f}.png"
                content = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 3])[1].tobytes()
                if not file.exists():
                    file.write_bytes(content)
                elif file.read_bytes() != content:
                    raise LogError(f"{file}: found two pictures of one stamp, expected each at its own time")
            progress(1)
