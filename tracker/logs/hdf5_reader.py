"""The platform's HDF5 camera logs, versions 1 and 2, with poses or without, read a part at a time.

    images                      (n, C, H, W) uint8, raw Bayer pixels
    timestamps, object_pose/…   (n, k) numbers of each frame
    camera_names                (C,) texts
    camera_info/NAME/settings   (k,) uint8: what a camera was set to, the text of a JSON object

Settings are bytes rather than a text, since the library does not survive damaged texts.
"""

from __future__ import annotations

import json
import math
import struct
from contextlib import suppress
from pathlib import Path

import h5py
import numpy as np

from tracker.calibration.camera_info import read_rig
from tracker.calibration.rig import CameraRig
from tracker.checks import described
from tracker.conventions import Array, FloatArray, Image
from tracker.errors import LogError
from tracker.files import hdf5, open_regular, told_of
from tracker.files.hdf5 import TooLong, check_stated_end, faults_as_log_errors, find, open_file, text_of
from tracker.logs.frame import LogFrame, RecordedPose, checked_stamp, empty_frame, is_empty, pose_from_record
from tracker.logs.log import DEFAULT_NAMES, MAX_SIDE, MIN_SIDE, Settings, Source
from tracker.logs.pictures import from_bayer

MAX_CAMERAS = 16

_ROWS = 512  # rows of a small field that are read at once
_MAX_SETTINGS = 1 << 16  # bytes of one camera
_MAX_NAME = 400  # bytes: 100 letters
_MAX_HEAP = 1 << 20
_REFERENCE = struct.Struct("<IQI")  # length, address of the heap, number in it
_HEAP_HEAD = struct.Struct("<4sB3xQ")
_OBJECT_HEAD = struct.Struct("<HH4xQ")


class StoredImages:
    """The field `images`, (n, C, H, W) uint8."""

    def __init__(self, field: h5py.Dataset, where: str) -> None:
        """LogError if the field cannot be images."""
        shape: tuple[int, ...] = field.shape or ()
        sides = len(shape) == 4 and all(MIN_SIDE <= side <= MAX_SIDE for side in shape[2:])
        if not sides or not 1 <= shape[1] <= MAX_CAMERAS or field.dtype != np.uint8:
            raise LogError(
                f"{where}: images: found {described(field)}, expected uint8 of (frames, 1 to "
                f"{MAX_CAMERAS} cameras, {MIN_SIDE} to {MAX_SIDE} rows, as many columns)"
            )
        self._field = field
        self.count, self.cameras, self.rows, self.columns = (int(side) for side in shape)
        frame_bytes = self.cameras * self.rows * self.columns
        stored = int(field.chunks[0]) if field.chunks else 1
        # Frames that are packed together are unpacked together, else each would unpack them all again.
        self._together = stored if 1 < stored <= self.count and stored * frame_bytes <= hdf5.MAX_CHUNK else 1
        # To shuffle the bytes of numbers of one byte does nothing.
        filters = [code for code in hdf5.filters_of(field) if code != h5py.h5z.FILTER_SHUFFLE]
        gzipped = filters == [h5py.h5z.FILTER_DEFLATE]
        self._whole_frames = gzipped and bool(field.chunks) and field.chunks[1:] == shape[1:]
        self._start = 0
        self._block: Image = np.empty((0, 0, 0, 0), np.uint8)

    def read(self, index: int, what: str) -> Image:
        """(C, H, W) raw pixels of a frame; LogError where they are damaged or were never written."""
        if not self._start <= index < self._start + len(self._block):
            start = index - index % self._together
            with hdf5.faults_as_log_errors(f"{what}: images"):
                block = self._unpacked(start) if self._whole_frames else self._read_by_library(start)
            self._block, self._start = block, start
        result: Image = self._block[index - self._start]
        return result

    def _read_by_library(self, start: int) -> Image:
        if self._field.chunks:
            self._check_chunks(start)
        block: Image = self._field[start : start + self._together]
        return block

    def _unpacked(self, start: int) -> Image:
        """What a block unpacks to, without trusting it to be no more than it should."""
        chunks = self._field.chunks
        first = start - start % chunks[0]
        skipped, packed = self._field.id.read_direct_chunk((first, 0, 0, 0))
        whole = math.prod(chunks)
        gzip = hdf5.filters_of(self._field).index(h5py.h5z.FILTER_DEFLATE)
        content = packed if skipped >> gzip & 1 else hdf5.inflated(packed, whole)
        if len(content) != whole:
            raise LogError(f"images at {first}: found {len(content)} bytes, expected {whole}")
        frames = np.frombuffer(content, np.uint8).reshape(chunks)
        last = min(start - first + self._together, self.count - first)
        block: Image = frames[start - first : last].copy()  # the user's own, to change
        return block

    def _check_chunks(self, start: int) -> None:
        """Refuse what the library passes silently: blocks that are missing, or cut off and not packed."""
        chunks = self._field.chunks
        whole = math.prod(chunks)
        packed = self._field.id.get_create_plist().get_nfilters() > 0
        for corner in np.ndindex(
            *(-(-side // chunk) for side, chunk in zip(self._field.shape[1:], chunks[1:], strict=True))
        ):
            offset = (
                start - start % chunks[0],
                *(int(c) * k for c, k in zip(corner, chunks[1:], strict=True)),
            )
            # The same search as reading does; it raises where there is no block.
            skipped, stored = self._field.id.read_direct_chunk(offset)
            if (skipped or not packed) and len(stored) < whole:
                raise LogError(f"images at {offset}: found {len(stored)} bytes, expected {whole}")


class Rows:
    """A field with a few numbers for each frame; a block of rows at a time is in memory."""

    def __init__(self, field: h5py.Dataset, width: int, what: str) -> None:
        """Args: a field of shape (n, width), or (n,) where width is 1; LogError if it is another."""
        shape = field.shape or ()
        if not shape or math.prod(shape[1:]) != width or field.dtype not in (np.float64, np.bool_, np.uint8):
            raise LogError(f"{what}: found {described(field)}, expected {width} numbers for each frame")
        with hdf5.faults_as_log_errors(what):
            hdf5.check_unpacked(field)
        self._field, self._width, self._what = field, width, what
        self._start = 0
        self._block: FloatArray = np.empty((0, width))

    def __len__(self) -> int:
        return int(self._field.shape[0])

    def __getitem__(self, index: int) -> FloatArray:
        """(width,) numbers of a frame."""
        if not self._start <= index < self._start + len(self._block):
            start = index - index % _ROWS
            with hdf5.faults_as_log_errors(self._what):
                rows: Array = self._field[start : start + _ROWS]
                self._block = np.asarray(rows, dtype=np.float64).reshape(-1, self._width)
            self._start = start
        result: FloatArray = self._block[index - self._start]
        return result


def read_names(field: h5py.Dataset, count: int, path: Path) -> tuple[str, ...]:
    """The names in the field `camera_names`; LogError if they are not `count` different ones.

    Strings of variable length lie in a heap of the file, and in a damaged heap the HDF5 library reads
    beyond its memory, which ends the process, or searches without end: so it does, in version 2.0 still,
    with 39 of the 1,664 bits of a heap of three names flipped. Therefore these few bytes are read here.
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
            raise LogError(f"found {described(field)}, expected {count} names")
        if field.id.get_storage_size() != count * size:
            raise LogError(f"found {field.id.get_storage_size()} bytes, expected {count * size}")
    try:
        data = _bytes_at(path, offset, count * size)
        parts = [data[k * size : (k + 1) * size] for k in range(count)]
        found = parts if fixed else [_from_heap(path, part) for part in parts]
        names = tuple(name.rstrip(b"\0").decode("utf-8") for name in found)
    except (struct.error, UnicodeDecodeError, LogError) as error:
        raise LogError(f"{what}: found damaged names ({error}), expected {count}") from error
    if len(set(names)) < count:
        raise LogError(f"{what}: found {', '.join(names)!r}, expected {count} different names")
    return names


def _from_heap(path: Path, reference: bytes) -> bytes:
    length, address, sought = _REFERENCE.unpack(reference)
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
        if number == sought and number and length <= stored:
            return heap[at : at + length]
        if number == 0:  # what is free
            break
        at += -(-stored // 8) * 8
    raise LogError("a name that the heap does not hold")


def _bytes_at(path: Path, offset: int, size: int) -> bytes:
    with told_of(path), open_regular(path) as file:
        if offset >= file.seek(0, 2):
            raise LogError("beyond the end of the file")
        file.seek(offset)
        return file.read(size)


def _refuse(constant: str) -> float:
    raise ValueError(f"found {constant}, expected a finite number")


_POSE = {"position": 3, "orientation": 4, "confidence": 1}
"""Fields of a pose, and how many numbers each has."""

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
        except TooLong as error:  # as a killed writer leaves it, if it is a writer's
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
        poses = [self._rows(f"object_pose/{name}", width) for name, width in _POSE.items()]
        self._has_pose = self._rows("object_pose/has_pose", 1)
        self._poses = [rows for rows in poses if rows is not None]
        if len(self._poses) not in (0, len(_POSE)):
            raise LogError(f"{where}: object_pose: expected position, orientation and confidence together")
        self.format += ", with poses" if self._poses else ""
        self._take_count(recover)

    def _take_count(self, recover: bool) -> None:
        fields = [self._camera_stamps, self._frame_stamps, *self._poses, self._has_pose]
        counts = {self._images.count, *(len(field) for field in fields if field is not None)}
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
        found = {name: self._settings(f"camera_info/{name}/settings") for name in self.camera_names}
        return {name: values for name, values in found.items() if values is not None}

    def _settings(self, path: str) -> Settings | None:
        field, what = find(self._file, path, f"{self.path}: "), f"{self.path}: {path}"
        if field is None:
            return None
        if field.dtype != np.uint8 or field.ndim != 1 or field.size > _MAX_SETTINGS:
            raise LogError(f"{what}: found {described(field)}, expected up to {_MAX_SETTINGS} bytes")
        with faults_as_log_errors(what):
            values = json.loads(field[:].tobytes(), parse_constant=_refuse)
        if not isinstance(values, dict) or not all(
            isinstance(value, (str, int, float, bool)) for value in values.values()
        ):
            raise LogError(f"{what}: expected names of settings with texts or numbers")
        settings: Settings = values
        return settings

    def close(self) -> None:
        """See Source."""
        with suppress(RuntimeError, OSError, ValueError):  # a damaged file was only read
            self._file.close()

    def _pose(self, index: int, where: str) -> RecordedPose | None:
        if not self._poses or (self._has_pose is not None and not self._has_pose[index][0]):
            return None
        numbers = np.concatenate([rows[index] for rows in self._poses])
        return pose_from_record(numbers, what=f"{where}, object_pose")

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
            if attribute.dtype.kind not in "iu" or attribute.shape not in ((), (1,)):
                raise LogError(f"found {described(attribute)}, expected a whole number")
            return int(np.asarray(self._file.attrs[name]).reshape(()))

    def _check_head(self) -> None:
        # Written from a C++ int, or from Python as int64.
        magic = self._attribute("magic")
        if magic is None and (stated := text_of(self.path, "format")):  # as files of poses do
            raise LogError(f"{self.path}: found a file of {stated!r:.60}, expected a camera log in HDF5")
        if magic != MAGIC:
            found = "none" if magic is None else f"{magic:#x}"
            raise LogError(f"{self.path}: magic: found {found}, expected {MAGIC:#x} of a camera log in HDF5")
        version, minor = self._attribute("format_version"), self._attribute("format_version_minor")
        if version not in VERSIONS:
            raise LogError(f"{self.path}: format_version: found {version}, expected 1 or 2")
        self.format = f"HDF5 camera log, version {version}.{minor or 0}"

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
