"""Writes the platform's HDF5 camera logs, version 2.1: frame by frame, or a whole recording."""

from __future__ import annotations

import contextlib
import json
import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from tracker.calibration.camera_info import CAMERA_DATASETS, write_arena
from tracker.calibration.rig import CameraRig
from tracker.checks import check_sequence, float_array, is_number, naming, of_kind, path_of, seconds
from tracker.conventions import Array, FloatArray, Image
from tracker.errors import LogError, message, shown
from tracker.files import whole_file, writing
from tracker.files.hdf5 import Disk
from tracker.logs.frame import StampOrder, checked_stamp, pose_from_record
from tracker.logs.hdf5_reader import FLUSHED, MAGIC, POSE
from tracker.logs.log import Log, Progress, Settings
from tracker.logs.pictures import to_bayer
from tracker.processes import uninterrupted

VERSION = (2, 1)
"""Values of the attributes `format_version` and `format_version_minor`."""

_ROWS = 256  # rows per chunk of a small field
_GZIP = 1  # level; raw pixels are mostly noise: higher ones save one per cent and take several times as long


class Hdf5LogWriter(contextlib.AbstractContextManager["Hdf5LogWriter"]):
    """A log that grows by one frame at a time; a context manager.

    Flushed frames can be read even if the process is killed afterwards: until the file is finished, its
    attribute FLUSHED holds their number.

    Args:
        path: a file that does not exist yet.
        rig: the cameras, in the order of the images; their sizes are those of the images.
        frame_rate: frame rate of the cameras [Hz], if it is known.
        poses: whether the object's poses are recorded.
        flush_every: number of frames between flushes to the operating system; 0: only at the end.
        name: name of the file in errors; None: its path.
        settings: settings of each camera, such as exposure and gain; empty: unknown.

    Raises:
        LogError: the file exists already or cannot be written, the cameras' images differ in size, or an
            argument cannot be written.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        rig: CameraRig,
        *,
        frame_rate: float | None = None,
        poses: bool = False,
        flush_every: int = 10,
        name: str | os.PathLike[str] | None = None,
        settings: Sequence[Settings] = (),
    ) -> None:
        path = path_of(path, "log", LogError)
        self._path = os.fspath(path if name is None else name)
        of_kind(rig, CameraRig, f"{self._path}: rig", LogError, "tracker.CameraRig.load")
        self._size, *others = {(camera.width, camera.height) for camera in rig}
        if others:
            found = ", ".join(f"{camera.width}×{camera.height}" for camera in rig)
            raise LogError(f"{self._path}: found cameras of {found} px, expected images of one size")
        if frame_rate is not None and not (is_number(frame_rate) and frame_rate > 0):
            raise LogError(f"{self._path}: frame_rate: found {shown(frame_rate)}, expected above 0 Hz")
        check_sequence(settings, f"{self._path}: settings", LogError)
        if len(settings) not in (0, len(rig)):
            raise LogError(f"{self._path}: settings: found {len(settings)}, expected {len(rig)}")
        what = f"{self._path}: settings: expected texts and numbers by name"
        with naming(what, LogError, AttributeError, TypeError, ValueError, OverflowError):
            texts = [_text_of(values) for values in settings]
        self._rig, self._flush_every = rig, flush_every
        self._count = 0
        self._order = StampOrder(gaps=False)
        if os.path.lexists(path):
            raise LogError(f"{self._path}: there is such a file, expected a new one")
        with uninterrupted(), contextlib.ExitStack() as undo:
            with writing(LogError, self._path):
                self._disk = undo.enter_context(Disk(path))
            self._file = undo.enter_context(h5py.File(self._disk, "w"))
            self._begin(frame_rate, poses, texts or [b""] * len(rig))
            self._check_disk()
            undo.pop_all()

    def __exit__(self, *_: object) -> None:
        self.close()

    def __len__(self) -> int:
        """Number of frames so far."""
        return self._count

    def append(
        self,
        images: Sequence[Image | None],
        timestamp: float,
        camera_timestamps: Sequence[float] | FloatArray | None = None,
        pose: Any = None,
    ) -> None:
        """Add a frame.

        Args:
            images: one per camera: raw Bayer pixels (H, W), red at even rows and columns, or BGR (H, W, 3),
                of which each pixel keeps the colour that such a sensor measures there. None, a missing
                image, is recorded as black, and is read as missing unless it is the camera's first.
            timestamp: timestamp of the frame [s], at most an hour after the previous frame and not before it.
            camera_timestamps: (C,) timestamps of the images [s]; None, or NaN for one image: the frame's. A
                missing image has that of the camera's image before. NaN for all, without images: a driver
                error, read as a frame without images.
            pose: the object's pose, with `position`, `orientation` and `confidence`, or None; recorded only
                if the log was opened with `poses`.

        Raises:
            LogError: images or timestamps do not fit the log, or writing fails; the log is unchanged.
        """
        where = f"{self._path}: frame {self._count}"
        if not self._file:
            raise LogError(f"{where}: the recording is closed")
        raw = self._raw(images, where)
        stamp = checked_stamp(timestamp, what=where)
        given = stamps = np.full(len(self._rig), np.nan)
        unseen = np.array([image is None for image in images])
        if camera_timestamps is not None:
            given = seconds(camera_timestamps, f"{where}: camera_timestamps", LogError)
            if given.shape != stamps.shape:
                raise LogError(f"{where}: found stamps of shape {given.shape}, expected {stamps.shape}")
        # A driver error left the frame empty if it has neither: recorded as zeros.
        if camera_timestamps is None or not (np.isnan(given).all() and unseen.all()):
            # A camera that lags or leads has other timestamps than the frame: its last one is repeated.
            last = self._order.camera_timestamps
            stamps = np.where(np.isnan(given), stamp, given)
            stamps = np.where(unseen & ~np.isnan(last), last, stamps)
            for value in stamps.tolist():
                checked_stamp(value, what=where)
        rows: dict[str, Any] = {
            "images": raw,
            "timestamps": np.nan_to_num(stamps),
            "sensor_data_timestamps": 1000 * stamp,
        }
        if "object_pose" in self._file:
            rows |= _pose_rows(pose, where)
        if fault := self._order.fault(self._count, stamp, stamps, where):  # last: it remembers the stamps
            raise fault
        with uninterrupted():
            self._write(rows)

    def _write(self, rows: dict[str, Any]) -> None:
        """Append a frame's rows; LogError if that fails: the log is unchanged."""
        try:
            for name, row in rows.items():
                field = self._file[name]
                field.resize(self._count + 1, axis=0)
                field[self._count] = row
            if self._flush_every and (self._count + 1) % self._flush_every == 0:
                self._flush(self._count + 1)
            self._check_disk()
        except (RuntimeError, ValueError, TypeError, LogError) as error:
            for name in rows:
                self._file[name].resize(self._count, axis=0)
            if isinstance(error, LogError):
                raise
            raise LogError(f"{self._path}: cannot be written: {message(error)}") from error
        self._count += 1

    def flush(self) -> None:
        """Write all frames so far to the operating system; LogError if that fails."""
        with uninterrupted():
            if self._file:  # closing it has flushed it
                self._flush(self._count)
            self._check_disk()

    def close(self) -> None:
        """Finish the file; LogError if it cannot be written."""
        with uninterrupted():
            if self._file:
                self._flush(self._count)
                del self._file.attrs[FLUSHED]
                self._file.close()
                self._disk.close()
                self._check_disk()

    def _flush(self, count: int) -> None:
        self._file.flush()  # the frames before their number, in case the process is killed in between
        self._file.attrs.modify(FLUSHED, np.uint64(count))
        self._file.flush()

    def _check_disk(self) -> None:
        if self._disk.fault is not None:
            with writing(LogError, self._path):
                raise self._disk.fault

    def _begin(self, frame_rate: float | None, poses: bool, settings: Sequence[bytes]) -> None:
        file, count, (width, height) = self._file, len(self._rig), self._size
        # The same types as in the platform's C++ code.
        for name, value in (
            ("magic", MAGIC), ("format_version", VERSION[0]), ("format_version_minor", VERSION[1]),
            ("num_cameras", count), ("image_width", width), ("image_height", height),
        ):  # fmt: skip
            file.attrs.create(name, value, dtype=np.uint32)
        file.attrs.create(FLUSHED, 0, dtype=np.uint64)
        write_arena(file, self._rig.arena)
        shape = (count, height, width)
        file.create_dataset(
            "images", (0, *shape), np.uint8, maxshape=(None, *shape), chunks=(1, *shape),
            compression="gzip", compression_opts=_GZIP, track_times=False,
        )  # fmt: skip
        self._rows("timestamps", (count,))
        self._rows("sensor_data_timestamps")
        if poses:
            self._rows("object_pose/has_pose", dtype=np.bool_)
            for name, row_shape in POSE.items():
                self._rows(f"object_pose/{name}", row_shape)
        file.create_dataset("camera_names", data=np.array([name.encode() for name in self._rig.names]))
        for camera, text in zip(self._rig, settings, strict=True):
            group = file.create_group(f"camera_info/{camera.name}")
            for key, (attribute, size) in CAMERA_DATASETS.items():
                if (array := getattr(camera, attribute)) is not None:
                    group[key] = array.reshape(size)
            if frame_rate is not None:
                group.attrs["frame_rate_fps"] = float(frame_rate)
            if text:
                group["settings"] = np.frombuffer(text, np.uint8)

    def _rows(self, name: str, shape: tuple[int, ...] = (), dtype: Any = np.float64) -> None:
        self._file.create_dataset(
            name, (0, *shape), dtype, maxshape=(None, *shape), chunks=(_ROWS, *shape), track_times=False
        )

    def _raw(self, images: Sequence[Image | None], where: str) -> Array:
        """Return (C, H, W) raw pixels."""
        (width, height), cameras = self._size, self._rig.names
        check_sequence(images, f"{where}: images", LogError)
        if len(images) != len(cameras):
            raise LogError(f"{where}: found {len(images)} images, expected {len(cameras)}")
        raw = np.zeros((len(cameras), height, width), np.uint8)
        for c, (name, image) in enumerate(zip(cameras, images, strict=True)):
            if image is None:
                continue
            shapes = (height, width), (height, width, 3)
            if not isinstance(image, np.ndarray) or image.dtype != np.uint8 or image.shape not in shapes:
                found, valid = shown(image), f"{shapes[0]} or {shapes[1]}"
                raise LogError(f"{where}: {name}: found {found}, expected uint8 of {valid}")
            raw[c] = image if image.ndim == 2 else to_bayer(image)
        return raw


def _text_of(settings: Settings) -> bytes:
    """Return the settings as JSON without those that are not finite; empty if there are no others."""
    known = {key: one for key, one in settings.items() if isinstance(one, str) or math.isfinite(one)}
    return json.dumps(known, default=float).encode() if known else b""  # float: NumPy's numbers


def _pose_rows(pose: Any, where: str) -> dict[str, Any]:
    """Return a frame's rows of the recorded pose; LogError if it could not be read again."""
    values = {name: np.zeros(shape) for name, shape in POSE.items()}
    for name, shape in {} if pose is None else POSE.items():
        if not hasattr(pose, name):
            valid = f"one with {', '.join(POSE)}"
            raise LogError(f"{where}: pose: found {shown(pose)}, expected {valid}")
        what = f"{where}: pose: {name}"
        values[name] = float_array(getattr(pose, name), shape, what, LogError, finite=False)
    pose_from_record(np.hstack([*values.values()]), what=f"{where}: pose")  # as when it is read
    rows = {f"object_pose/{name}": value for name, value in values.items()}
    return {"object_pose/has_pose": pose is not None, **rows}


def write_hdf5(path: Path, log: Log, rig: CameraRig, progress: Progress) -> None:
    """Write frames as a platform HDF5 log, whole or not at all; raw pixels are copied unchanged.

    LogError: it cannot be written, or its timestamps go back or jump, so that it could not be read.
    """
    has_poses = any(frame.recorded_pose is not None for frame in log)
    known = log.settings
    settings = [known.get(name, {}) for name in rig.names]
    with (
        writing(LogError, path),
        whole_file(path) as temporary,
        Hdf5LogWriter(temporary, rig, poses=has_poses, flush_every=0, name=path, settings=settings) as writer,
    ):
        for frame in log:
            images = frame.images if frame.raw is None else frame.raw
            writer.append(images, frame.timestamp, frame.camera_timestamps, frame.recorded_pose)
            progress(1)
