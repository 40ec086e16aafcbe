"""The platform's HDF5 camera logs, versions 1 and 2, with the object's poses or without."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import h5py
import numpy as np

from tracker.calibration.camera_info import read_rig
from tracker.calibration.rig import CameraRig
from tracker.checks import described
from tracker.conventions import Image
from tracker.errors import LogError
from tracker.files.hdf5 import TooLong, check_stated_end, faults_as_log_errors, find, open_file, text
from tracker.logs.frame import LogFrame, RecordedPose, checked_stamp, empty_frame, is_empty, pose_from_record
from tracker.logs.hdf5_fields import Rows, StoredImages, read_names, read_settings
from tracker.logs.log import DEFAULT_NAMES, Settings, Source
from tracker.logs.pictures import from_bayer

MAGIC = 0x3CDA7A00
VERSIONS = (1, 2)

FLUSHED = "frames_flushed"
"""Attribute of a log of this project that is still written, or whose writer was killed: how many frames were
handed over as a whole. What comes after them is left out."""


class Hdf5Source(Source):
    """An HDF5 log; of each field a block at a time is in memory."""

    def __init__(self, path: Path, *, recover: bool) -> None:
        super().__init__(path)
        end_fault: LogError | None = None
        try:
            check_stated_end(path)
        except TooLong as error:  # as a killed writer leaves it, if it is one's
            end_fault = error
        except LogError as error:
            if not recover:
                raise
            self.opening_fault = str(error)
        with faults_as_log_errors(str(path)):
            self._file = open_file(path)
        try:
            # Every property of a damaged field may raise.
            with faults_as_log_errors(str(path)):
                self._flushed = self._attribute(FLUSHED)
                if end_fault is not None:
                    if self._flushed is None and not recover:
                        raise end_fault
                    self.opening_fault = str(end_fault)
                self._open(recover)
        except BaseException:
            self.close()
            raise

    def _open(self, recover: bool) -> None:
        where = str(self.path)
        self._check_head()
        field = find(self._file, "images", f"{where}: ")
        if field is None:
            raise LogError(f"{where}: images is missing, expected a camera log")
        self._images = images = StoredImages(field, where)
        self._check_sizes()
        self.image_sizes = ((images.columns, images.rows),) * images.cameras
        self.camera_names = self._names()
        stamps = self._rows("timestamps", images.cameras)
        if stamps is None:
            raise LogError(f"{where}: timestamps is missing, expected a camera log")
        self._camera_stamps = stamps
        self._frame_stamps = self._rows("sensor_data_timestamps", 1)
        self._position = self._rows("object_pose/position", 3)
        self._orientation = self._rows("object_pose/orientation", 4)
        self._confidence = self._rows("object_pose/confidence", 1)
        self._has_pose = self._rows("object_pose/has_pose", 1)
        poses = [self._position, self._orientation, self._confidence]
        if any(poses) and not all(poses):
            raise LogError(f"{where}: object_pose: expected position, orientation and confidence together")
        self.format += ", with poses" if self._position else ""
        self._take_count(recover)

    def _take_count(self, recover: bool) -> None:
        fields = [self._camera_stamps, self._frame_stamps, self._position, self._orientation]
        counts = {len(field) for field in [*fields, self._confidence, self._has_pose] if field is not None}
        counts.add(self._images.count)
        self.count = min(counts)
        if self._flushed is not None and self._flushed <= self.count:
            self.count = self._flushed
            self.opening_fault = f"{self.path}: its writer was ended before it had finished the file"
            return
        if len(counts) > 1:
            text = f"{self.path}: found fields of {sorted(counts)} frames, expected one number"
            if not recover:
                raise LogError(text)
            self.opening_fault = text

    def read(self, index: int) -> LogFrame:
        """See Source."""
        where = self.where(index)
        stamps = self._camera_stamps[index].copy()
        for number, value in enumerate(stamps, start=1):
            checked_stamp(value, what=f"{where}, camera number {number}")
        raw = self._images.read(index, where)
        if is_empty(stamps, [raw]):
            return empty_frame(index, len(stamps))
        if self._frame_stamps is None:
            stamp = float(np.mean(stamps))
        else:
            stamp = checked_stamp(self._frame_stamps[index][0] / 1000, what=where)
        pose = self._pose(index, where)
        images: tuple[Image, ...] = tuple(from_bayer(camera) for camera in raw)
        return LogFrame(index, stamp, stamps, images, pose, None, tuple(raw))

    def rig(self) -> CameraRig | None:
        """See Source."""
        with faults_as_log_errors(str(self.path)):
            inside = read_rig(self._file, self.camera_names, self.image_sizes[0], f"{self.path}: ")
        return inside or super().rig()

    def settings(self) -> dict[str, Settings]:
        """See Source."""
        return read_settings(self._file, self.camera_names, str(self.path))

    def close(self) -> None:
        """See Source."""
        with suppress(RuntimeError, OSError, ValueError):  # a damaged file was only read
            self._file.close()

    def _pose(self, index: int, where: str) -> RecordedPose | None:
        if self._position is None or self._orientation is None or self._confidence is None:
            return None
        if self._has_pose is not None and not self._has_pose[index][0]:
            return None
        parts = [self._position[index], self._orientation[index], self._confidence[index]]
        return pose_from_record(np.concatenate(parts), what=f"{where}, object_pose")

    def _rows(self, name: str, width: int) -> Rows | None:
        field = find(self._file, name, f"{self.path}: ")
        return None if field is None else Rows(field, width, f"{self.path}: {name}")

    def _attribute(self, name: str) -> int | None:
        """A whole number among the file's attributes, or None where there is none of this name."""
        with faults_as_log_errors(f"{self.path}: {name}"):
            if name not in self._file.attrs:
                return None
            attribute = self._file.attrs.get_id(name)
            # Before it is read: the library does not survive damaged texts.
            whole = isinstance(attribute.get_type(), h5py.h5t.TypeIntegerID)
            if not whole or attribute.shape not in ((), (1,)) or attribute.dtype.itemsize > 8:
                raise LogError(f"found {described(attribute)}, expected a whole number")
            return int(np.asarray(self._file.attrs[name]).reshape(()))

    def _check_head(self) -> None:
        # Written from a C++ int, or from Python as int64.
        magic = self._attribute("magic")
        if magic is None and (said := self._said_format()):
            raise LogError(f"{self.path}: found a file of {said!r:.60}, expected a camera log in HDF5")
        if magic != MAGIC:
            found = "none" if magic is None else f"{magic:#x}"
            raise LogError(f"{self.path}: magic: found {found}, expected {MAGIC:#x} of a camera log in HDF5")
        version, minor = self._attribute("format_version"), self._attribute("format_version_minor")
        if version not in VERSIONS:
            raise LogError(f"{self.path}: format_version: found {version}, expected 1 or 2")
        self.format = f"HDF5 camera log, version {version}.{minor or 0}"

    def _said_format(self) -> str | None:
        """What other files say that they are, files of poses for instance."""
        try:
            return text(self._file, "format")
        except (LogError, OSError, KeyError, RuntimeError, ValueError, TypeError):
            return None

    def _check_sizes(self) -> None:
        images = self._images
        sizes = {"num_cameras": images.cameras, "image_width": images.columns, "image_height": images.rows}
        for name, expected in sizes.items():
            found = self._attribute(name)
            if found is not None and found != expected:
                raise LogError(f"{self.path}: {name}: found {found}, expected {expected} as in images")

    def _names(self) -> tuple[str, ...]:
        count = self._images.cameras
        default = DEFAULT_NAMES if count == 3 else tuple(f"camera{number}" for number in range(count))
        field = find(self._file, "camera_names", f"{self.path}: ")
        if field is None:
            return default
        return read_names(field, count, self.path)
