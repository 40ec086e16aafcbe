"""The platform's HDF5 camera logs, versions 1 and 2, with or without poses.

    images                      (n, C, H, W) uint8, raw Bayer pixels
    timestamps, object_pose/…   (n, k) numbers of each frame
    camera_names                (C,) strings
    camera_info/NAME/settings   (k,) uint8: a camera's settings, the text of a JSON object

Settings are stored as bytes, not as strings, since the HDF5 library crashes on damaged strings.
"""

import dataclasses
import itertools
import json
import math
import struct
from contextlib import suppress
from io import BufferedReader
from pathlib import Path

import h5py
import numpy as np

from tracker.calibration.camera_info import read_arena, read_camera
from tracker.calibration.rig import CameraRig
from tracker.checks import described, is_number, naming
from tracker.conventions import FloatArray, Image
from tracker.errors import CalibrationError, LogError
from tracker.files import hdf5, on_error, open_regular, reading
from tracker.files.hdf5 import check_stated_end, faults_as_log_errors, find, open_file, text_of
from tracker.logs.frame import EPOCH, UNKNOWN, LogFrame, recorded_frame
from tracker.logs.log import MAX_CAMERAS, MAX_SIDE, MIN_SIDE, Settings, Source, default_names
from tracker.logs.pictures import from_bayer

POSE: dict[str, tuple[int, ...]] = {"position": (3,), "orientation": (4,), "confidence": ()}
"""Fields of a pose and their shapes."""

MAGIC = 0x3CDA7A00

FLUSHED = "frames_flushed"
"""Attribute of a log of this project that is still being written, or whose writer was killed: the number of
frames that were completely flushed. Later frames are ignored."""

_MAX_SETTINGS = 1 << 16  # bytes per camera
_MAX_NAME = 400  # bytes: 100 letters
_MAX_HEAP = 1 << 20
_REFERENCE = struct.Struct("<IQI")  # length, address of the heap, object number in it
_HEAP_HEAD = struct.Struct("<4sB3xQ")
_OBJECT_HEAD = struct.Struct("<HH4xQ")


class StoredImages:
    """The field `images`, (n, C, H, W) uint8; keeps the frames of one compressed block in memory."""

    def __init__(self, field: h5py.Dataset) -> None:
        """Raise LogError if the field cannot hold images."""
        shape: tuple[int, ...] = field.shape or ()
        sides = len(shape) == 4 and all(MIN_SIDE <= side <= MAX_SIDE for side in shape[2:])
        if not sides or not 1 <= shape[1] <= MAX_CAMERAS or field.dtype != np.uint8:
            raise LogError(
                f"images: found {described(field)}, expected uint8 of (frames, 1 to "
                f"{MAX_CAMERAS} cameras, {MIN_SIDE} to {MAX_SIDE} rows, as many columns)"
            )
        self._field = field
        self.count, self.cameras, self.rows, self.columns = (int(side) for side in shape)
        stored = int(field.chunks[0]) if field.chunks else 1
        # Unpack all frames of a block at once: reading each frame alone would unpack the whole block again.
        few = 1 < stored <= self.count and stored * math.prod(shape[1:]) <= hdf5.MAX_CHUNK
        self._together = stored if few else 1
        self._kept: tuple[int, Image] = 0, np.empty((0, 0, 0, 0), np.uint8)  # first frame, and pixels

    def read(self, index: int) -> Image:
        """Return (C, H, W) raw pixels of a frame; LogError if they are damaged or were never written."""
        start, frames = self._kept  # another thread may replace it
        if not start <= index < start + len(frames):
            start = index - index % self._together
            frames = self._read(start, min(start + self._together, self.count))
            self._kept = start, frames
        return np.array(frames[index - start])  # a copy: callers may change its pixels

    def _read(self, start: int, stop: int) -> Image:
        """Read frames of the same blocks, checking each block: the library would fill in missing ones."""
        field = self._field
        frames: Image = np.empty((stop - start, *field.shape[1:]), np.uint8)
        if field.chunks:
            first = start - start % field.chunks[0]
            steps = zip(field.shape[1:], field.chunks[1:], strict=True)
            for camera, row, column in itertools.product(*(range(0, side, step) for side, step in steps)):
                block = np.frombuffer(hdf5.unpacked(field, (first, camera, row, column)), np.uint8)
                part = frames[:, camera:, row:, column:]
                inside = block.reshape(field.chunks)[start - first :][tuple(map(slice, part.shape))]
                part[tuple(map(slice, inside.shape))] = inside
        if not field.chunks or h5py.h5z.FILTER_FLETCHER32 in hdf5.filters_of(field):
            frames = field[start:stop]  # the library verifies the checksums
        return frames


def read_names(field: h5py.Dataset, count: int, path: Path) -> tuple[str, ...]:
    """Return the names in the field `camera_names`; LogError unless there are `count` different ones.

    Strings of variable length are in a heap of the file. If it is damaged, the HDF5 library (still in 2.0)
    reads beyond its memory and crashes, or searches forever. Therefore this function reads the heap itself.
    """
    offset, variable = field.id.get_offset(), field.dtype.kind == "O"
    size = _REFERENCE.size if variable else int(field.dtype.itemsize)
    if field.shape != (count,) or field.dtype.kind not in "SO" or size > _MAX_NAME or offset is None:
        raise LogError(f"camera_names: found {described(field)}, expected {count} contiguous names")
    if (there := field.id.get_storage_size()) != count * size:
        raise LogError(f"camera_names: found {there} bytes, expected {count * size}")
    faults = (LogError, struct.error, UnicodeDecodeError, OverflowError)
    what = "camera_names: found damaged names"
    with naming(what, LogError, *faults), reading(path), open_regular(path) as file:
        file.seek(offset)
        found = [file.read(size) for _ in range(count)]
        if variable:
            found = [_from_heap(file, reference) for reference in found]
        names = tuple(name.rstrip(b"\0").decode("utf-8") for name in found)
    if len(set(names)) < count:
        raise LogError(f"camera_names: found {', '.join(names)!r}, expected {count} different names")
    return names


def _from_heap(file: BufferedReader, reference: bytes) -> bytes:
    length, address, sought = _REFERENCE.unpack(reference)
    if length > _MAX_NAME:
        raise LogError(f"a name of {length} bytes")
    file.seek(address)
    magic, version, size = _HEAP_HEAD.unpack(file.read(_HEAP_HEAD.size))
    if magic != b"GCOL" or version != 1 or not _HEAP_HEAD.size <= size <= _MAX_HEAP:
        raise LogError("no heap of names")
    heap, at = file.read(size - _HEAP_HEAD.size), 0
    while at + _OBJECT_HEAD.size <= len(heap):
        number, _, stored = _OBJECT_HEAD.unpack_from(heap, at)
        at += _OBJECT_HEAD.size
        if number == sought and number and length <= stored:
            return heap[at : at + length]
        at += -(-stored // 8) * 8
    raise LogError("a name that the heap does not hold")


class Hdf5Source(Source):
    """An HDF5 log; keeps one block of the images in memory."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.opening_fault = check_stated_end(path)
        with faults_as_log_errors(str(path)):
            self._file = open_file(path)
        # In a damaged file any property of a field may raise.
        with on_error(self.close), faults_as_log_errors(str(path)):
            self._open()

    def _open(self) -> None:
        self._flushed = self._attribute(FLUSHED)
        self.unfinished = self._flushed is not None
        self._check_head()
        if (field := find(self._file, "images")) is None:
            raise LogError("images is missing, expected a camera log")
        self._images = images = StoredImages(field)
        sizes = {"num_cameras": images.cameras, "image_width": images.columns, "image_height": images.rows}
        for name, expected in sizes.items():
            stated = self._attribute(name)
            if stated not in (None, expected):
                raise LogError(f"{name}: found {stated}, expected {expected} as in images")
        self.image_sizes = ((images.columns, images.rows),) * images.cameras
        self.camera_names = default_names(images.cameras)
        if (names := find(self._file, "camera_names")) is not None:
            self.camera_names = read_names(names, images.cameras, self.path)
        if (stamps := self._rows("timestamps", images.cameras)) is None:
            raise LogError("timestamps is missing, expected a camera log")
        self._camera_stamps = stamps
        # Number of the latest frame that is no driver error, for each frame.
        self._latest = np.maximum.accumulate(np.where(stamps.any(axis=1), np.arange(len(stamps)), 0))
        self._frame_stamps = self._rows("sensor_data_timestamps", 1)
        self._has_pose = self._rows("object_pose/has_pose", 1)
        poses = [self._rows(f"object_pose/{name}", math.prod(shape)) for name, shape in POSE.items()]
        self._poses = [rows for rows in poses if rows is not None]
        if len(self._poses) not in (0, len(POSE)):
            raise LogError("object_pose: expected position, orientation and confidence together")
        self.format += ", with poses" if self._poses else ""
        fields = [self._camera_stamps, self._frame_stamps, *self._poses, self._has_pose]
        counts = {self._images.count, *(len(field) for field in fields if field is not None)}
        self.count = min(counts)
        if self._flushed is not None and self._flushed <= self.count:
            self.count = self._flushed
            self.opening_fault = f"{self.path}: its writer was ended before it had finished the file"
        elif len(counts) > 1:
            self.opening_fault = f"{self.path}: found fields of {sorted(counts)} frames, expected one number"
            self.unfinished = False

    def read(self, index: int) -> LogFrame:
        """See Source."""
        where = self.where(index)
        with faults_as_log_errors(f"{where}: images"):
            raw = self._images.read(index)
        stamps, poses = self._camera_stamps[index].copy(), []
        stamp = None if self._frame_stamps is None else self._frame_stamps[index, 0]
        if self._poses and (self._has_pose is None or self._has_pose[index]):
            poses = [np.concatenate([rows[index] for rows in self._poses])]
        # A missing image is recorded as black, with the timestamp of the camera's image before.
        before = self._camera_stamps[self._latest[index - 1]] if index else np.full(len(stamps), np.nan)
        # An empty record of the platform has stamps of 0, and what was in its images' memory before.
        empty = not stamps.any() and self._camera_stamps.max() > EPOCH
        missing = [empty or (same and not one.any()) for same, one in zip(stamps == before, raw, strict=True)]
        pixels = [None if no else one for no, one in zip(missing, raw, strict=True)]
        images = [None if one is None else from_bayer(one) for one in pixels]
        frame = recorded_frame(index, images, pixels, stamps, stamp, poses, where=where)
        known = np.where(missing, np.nan, frame.camera_timestamps)
        return dataclasses.replace(frame, camera_timestamps=known, stamps=UNKNOWN)

    def rig(self) -> CameraRig | None:
        """See Source."""
        with faults_as_log_errors(str(self.path)), naming("/camera_info", LogError, CalibrationError):
            if hdf5.has_group(self._file, "camera_info"):
                names, size = self.camera_names, self.image_sizes[0]
                cameras = tuple(read_camera(self._file, name, size) for name in names)
                return CameraRig(cameras, read_arena(self._file))
        return super().rig()

    def settings(self) -> dict[str, Settings]:
        """See Source."""
        found: dict[str, Settings] = {}
        for camera in self.camera_names:
            name = f"camera_info/{camera}/settings"
            with faults_as_log_errors(f"{self.path}: {name}"):
                if (field := find(self._file, name)) is None:
                    continue
                if field.dtype != np.uint8 or field.ndim != 1 or field.size > _MAX_SETTINGS:
                    raise LogError(f"found {described(field)}, expected up to {_MAX_SETTINGS} bytes")
                found[camera] = values = json.loads(hdf5.values(field).tobytes())
                if not isinstance(values, dict) or not all(
                    isinstance(value, str | bool) or is_number(value) for value in values.values()
                ):
                    raise LogError("expected names of settings with texts or finite numbers")
        return found

    def close(self) -> None:
        """See Source."""
        with suppress(RuntimeError, OSError, ValueError):  # nothing is lost: the file was only read
            self._file.close()

    def _rows(self, name: str, width: int) -> FloatArray | None:
        """Return (n, width) numbers of the frames, or None if there is no such field."""
        if (field := find(self._file, name)) is None:
            return None
        shape = field.shape or ()
        if not shape or math.prod(shape[1:]) != width or field.dtype not in (np.float64, np.bool_, np.uint8):
            expected = f"float64, bool or uint8, {width} for each frame"
            raise LogError(f"{name}: found {described(field)}, expected {expected}")
        with faults_as_log_errors(f"{self.path}: {name}"):
            # Rows after the flushed ones may be half written.
            return hdf5.values(field, self._flushed).astype(np.float64).reshape(-1, width)

    def _attribute(self, name: str) -> int | None:
        """Return an integer attribute of the file, or None if there is none with this name."""
        return int(hdf5.attribute(self._file, name, "iu")) if name in self._file.attrs else None

    def _check_head(self) -> None:
        # Any integer type: writers in C++ store an int, those in Python an int64.
        magic = self._attribute("magic")
        if magic is None and (stated := text_of(self.path, "format")):  # such as a file of poses
            raise LogError(f"found a file of {stated!r:.60}, expected a camera log in HDF5")
        if magic != MAGIC:
            found = "none" if magic is None else f"{magic:#x}"
            raise LogError(f"magic: found {found}, expected {MAGIC:#x} of a camera log in HDF5")
        version, minor = self._attribute("format_version"), self._attribute("format_version_minor")
        if version not in (1, 2):
            raise LogError(f"format_version: found {version}, expected 1 or 2")
        self.format = f"HDF5 camera log, version {version}.{minor or 0}"
