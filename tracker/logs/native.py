"""The platform's native camera logs, `camera_data.dat`, plain or gzipped.

    u32 version = 1 | u64 n | n × record
    record = f64 stamp [ms] | 3 × camera | no pose, one, or the measured and the filtered one
    camera = i32 rows | i32 cols | i32 type | u8 continuous | pixels | f64 stamp [s]
    pose   = px py pz qx qy qz qw confidence, in autumn 2020 after a ninth number

The oldest files have neither a version nor record timestamps. Files do not state their variant: the reader
tries all variants, and picks the one for which the second record's first camera has the right header.
Numbers are checked before they determine any size.
"""

import gzip
import os
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from tracker.checks import naming
from tracker.errors import LogError
from tracker.files import OneAtATime, on_error, open_regular, reading
from tracker.logs.frame import LogFrame, recorded_frame
from tracker.logs.log import MAX_SIDE, MIN_SIDE, Source, default_names
from tracker.logs.pictures import from_bayer

_CAMERAS = 3
_EMPTY = (b"", struct.pack("<IQ", 1, 0), struct.pack("<Q", 0))
_GZIP_MAGIC = b"\x1f\x8b"
_MOST_RECORDS = 10_000_000  # a larger stated number is damaged
_MAX_RATIO = 1032  # deflate packs at most this many bytes into one

_HEADER = struct.Struct("<iiiB")  # of a camera: rows, columns, type, continuous
_SAME = 12  # bytes of the header that are equal in all records: all but `continuous`
_CHANNELS = {0: (), 16: (3,)}  # channels by OpenCV's type: Bayer pixels, or BGR
_POSES = ((0, 0), (1, 8), (2, 8), (1, 9), (2, 9))  # variants: number of poses, numbers per pose
_STAMPS = {True: (12, 20), False: (8, 8)}
"""Offsets of the first record and of its first camera, by whether records have timestamps."""


class NativeSource(Source):
    """A native log. If it is not gzipped, each record is found by its number.

    Records are read, not memory-mapped: if a mapped file shrinks or its disk fails, a signal ends the
    process, while reading raises an error.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.camera_names = default_names(_CAMERAS)
        self._alone = OneAtATime(path)
        with reading(path):
            self._raw = open_regular(path)
            self.sequential = self._raw.read(len(_GZIP_MAGIC)) == _GZIP_MAGIC
        with on_error(self.close):
            # A gzip file states the size of its content only modulo 2³², and only at its end.
            size = os.fstat(self._raw.fileno()).st_size
            self._largest = size * _MAX_RATIO if self.sequential else size
            if self.sequential:
                self._rewind()
            self._open()

    def _open(self) -> None:
        self.format = "native camera log"
        self.count = 0
        head = self._read_at(0, 13)
        if not head:
            raise LogError(f"{self.path}: found nothing in it, expected a camera log")
        self._end = len(head)
        if head in _EMPTY:
            return
        stated = self._find_layout()
        self.image_sizes = tuple((columns, rows) for rows, columns, _ in self._headers)
        self.format += "" if self._stamped else " of the oldest kind"
        poses = self._record["poses"].shape[0]
        self.format += {0: "", 1: ", with poses", 2: ", with poses and filtered poses"}[poses]
        self.format += ", gzipped" if self.sequential else ""
        size = self._record.itemsize
        fitting, left = divmod(self._largest - self._start, size)
        if stated > fitting if self.sequential else (fitting, left) != (stated, 0):
            self.opening_fault = (
                f"{self.path}: found {'at most ' * self.sequential}{self._largest} bytes, that is "
                f"{fitting} records of {size} bytes and {left} bytes, expected {stated} records"
            )
        self.count = min(stated, fitting)
        self.missing = max(min(stated, _MOST_RECORDS) - self.count, 0)
        self._end = self._start + self.count * size

    def read(self, index: int) -> LogFrame:
        """See Source; LogError also if the record's layout differs from the first."""
        where, size = self.where(index), self._record.itemsize
        record = np.empty(1, self._record)  # new for each frame, so that its raw pixels need no copy
        count = self._read_into(record.view(np.uint8).data, self._start + index * size)
        if count < size:
            raise LogError(f"{where}: found {count} bytes, expected a record of {size}")
        cameras = list(record["cameras"][0])
        for number, (camera, expected) in enumerate(zip(cameras, self._headers, strict=True), start=1):
            what = f"{where}, camera number {number}"
            header = _header(camera["header"].tobytes(), what)
            if header != expected:
                raise LogError(f"{what}: found {_shown(header)}, expected {_shown(expected)} as in frame 0")
        pixels = [camera["pixels"] for camera in cameras]
        raw = pixels if all(one.ndim == 2 for one in pixels) else None
        # Copy colour images, so that a kept image does not keep the whole record in memory.
        images = [from_bayer(one) if one.ndim == 2 else one.copy() for one in pixels]
        stamps = np.array([camera["stamp"] for camera in cameras])
        stamp = record["stamp"][0] if self._stamped else None
        poses = record["poses"][0, :, -8:]
        return recorded_frame(index, images, raw, stamps, stamp, poses, where=where)

    def check_end(self) -> None:
        """See Source; reading to the end also makes gzip verify its checksum."""
        if self._read_at(self._end, 1) and self.opening_fault is None:
            raise LogError(f"{self.path}: found bytes after frame {self.count - 1}, expected the file's end")

    def close(self) -> None:
        """See Source."""
        self._raw.close()

    def _find_layout(self) -> int:
        """Find the layout of records from the first and second one; return the stated number of records."""
        count = self._read_head()
        start, offset = _STAMPS[self._stamped]
        first = self._read_at(offset, _SAME)
        headers = []
        for number in range(1, _CAMERAS + 1):
            what = f"{self.where(0)}, camera number {number}"
            headers.append(_header(self._read_at(offset, _HEADER.size), what))
            offset += _camera(headers[-1]).itemsize
        self._start, self._headers = start, headers
        stamp = [("stamp", "<f8")] * self._stamped
        cameras = np.dtype([(f"camera {number}", _camera(header)) for number, header in enumerate(headers)])
        variants = [np.dtype([*stamp, ("cameras", cameras), ("poses", "<f8", shape)]) for shape in _POSES]
        # Read on from the first record's cameras to the next camera's header in the longest variant.
        tail = self._read_at(offset, 8 * 18 + 8 + _HEADER.size)
        for self._record in variants:
            poses = self._record["poses"].itemsize
            after = poses + 8 * self._stamped
            if tail[after : after + _SAME] == first or (count == 1 and len(tail) == poses):
                return count
        for self._record in variants:  # the second record's header may be damaged
            if not self.sequential and self._largest == start + count * self._record.itemsize:
                return count
        size = "gzipped data" if self.sequential else f"{self._largest} bytes"
        raise LogError(
            f"{self.path}: after the images of frame 0 found neither poses and the next frame nor the end "
            f"of the log of {count} records: {size}, expected a native camera log that is whole"
        )

    def _read_head(self) -> int:
        """Find out whether records have timestamps; return the stated number of records."""
        head = self._read_at(0, 20 + _HEADER.size)
        for self._stamped, (_, offset) in _STAMPS.items():
            try:
                _header(head[offset:], "")
            except LogError:
                continue
            numbers = struct.unpack_from("<IQ" if self._stamped else "<Q", head)
            if self._stamped and numbers[0] != 1:
                raise LogError(f"{self.path}: found version {numbers[0]}, expected 1")
            if not numbers[-1]:
                raise LogError(f"{self.path}: found 0 records stated and some there, expected their number")
            return int(numbers[-1])
        raise LogError(
            f"{self.path}: found a file that starts with {head[:12].hex(' ')}, "
            "expected a camera log: native, gzipped or not, or HDF5"
        )

    def _read_at(self, offset: int, size: int) -> bytes:
        """Read up to `size` bytes of the content, fewer only at its end; LogError if it is damaged."""
        data = bytearray(size)
        return bytes(data[: self._read_into(memoryview(data), offset)])

    def _read_into(self, data: memoryview, offset: int) -> int:
        """Fill `data` with the content from `offset` on; return the number of bytes, fewer only at its end.

        In gzipped data, skipped bytes are unpacked, too, and seeking backwards starts from the beginning.
        """
        if not self.sequential:
            done = 0
            with reading(self.path):  # without moving the position, which threads and forked processes share
                while count := os.preadv(self._raw.fileno(), [data[done:]], offset + done):
                    done += count
            return done
        what = f"{self.path}: the gzipped data are damaged or truncated before byte {offset + len(data)}"
        fault = naming(f"{what} of the content", LogError, EOFError, zlib.error, gzip.BadGzipFile)
        with reading(self.path), self._alone.lock(), fault, on_error(self._rewind):
            self._file.seek(offset)
            return self._file.readinto(data)

    def _rewind(self) -> None:
        # Make a new gzip reader: the state of the old one after an error or Ctrl-C is undefined.
        self._raw.seek(0)
        self._file = gzip.GzipFile(fileobj=self._raw)


_Header = tuple[int, int, int]
"""Rows, columns, type."""


def _header(data: bytes, what: str) -> _Header:
    """Parse the header at the beginning of some bytes; LogError if it is invalid."""
    if len(data) < _HEADER.size:
        raise LogError(f"{what}: found the end of the file, expected a camera's header")
    rows, columns, kind, continuous = _HEADER.unpack_from(data)
    sides = MIN_SIDE <= rows <= MAX_SIDE and MIN_SIDE <= columns <= MAX_SIDE
    if not sides or kind not in _CHANNELS or continuous not in (0, 1):
        raise LogError(
            f"{what}: found {rows} rows, {columns} columns, type {kind}, continuous {continuous}, "
            f"expected {MIN_SIDE} to {MAX_SIDE} rows and columns, type 0 or 16, continuous 0 or 1"
        )
    return rows, columns, kind


def _camera(header: _Header) -> np.dtype[Any]:
    rows, columns, kind = header
    pixels = ("pixels", "u1", (rows, columns, *_CHANNELS[kind]))
    return np.dtype([("header", f"V{_HEADER.size}"), pixels, ("stamp", "<f8")])


def _shown(header: _Header) -> str:
    rows, columns, kind = header
    return f"{columns}×{rows} px of type {kind}"
