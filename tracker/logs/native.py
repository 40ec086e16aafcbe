"""The platform's native camera logs, `camera_data.dat`, plain or gzipped."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from tracker.conventions import Image
from tracker.errors import LogError
from tracker.logs.frame import LogFrame, RecordedPose, empty_frame, is_empty, pose_from_record
from tracker.logs.native_layout import CAMERA_HEADER, Layout, camera_shape, find_layout
from tracker.logs.native_stream import open_stream
from tracker.logs.pictures import from_bayer
from tracker.logs.source import Source
from tracker.logs.stamps import checked_stamp

_EMPTY = (b"", struct.pack("<IQ", 1, 0), struct.pack("<Q", 0))


class NativeSource(Source):
    """A native log; of a plain one each record is found by its number."""

    def __init__(self, path: Path, *, recover: bool) -> None:
        super().__init__(path)
        self._stream = open_stream(path)
        self.sequential = self._stream.gzipped
        try:
            self._open(recover)
        except BaseException:
            self._stream.close()
            raise

    def _open(self, recover: bool) -> None:
        self.format = "native camera log"
        self.count = 0
        head = self._stream.read_at(0, 13)
        if not head:
            raise LogError(f"{self.path}: found nothing in it, expected a camera log")
        self._end = len(head)
        if head in _EMPTY:
            return
        self._layout, stated = find_layout(self._stream, self.path)
        layout = self._layout
        self.image_sizes = tuple((shape.columns, shape.rows) for shape in layout.cameras)
        self.format += "" if layout.stamped else " of the oldest kind"
        self.format += {0: "", 1: ", with poses", 2: ", with poses and filtered poses"}[layout.poses]
        self.format += ", gzipped" if self._stream.gzipped else ""
        fitting, left = divmod(self._stream.largest - layout.start, layout.record)
        wrong = stated > fitting if self._stream.gzipped else (fitting, left) != (stated, 0)
        if wrong:
            text = (
                f"{self.path}: found {'at most ' * self._stream.gzipped}{self._stream.largest} bytes, "
                f"that is {fitting} records of {layout.record} bytes and {left} bytes, "
                f"expected {stated} records"
            )
            if not recover:
                raise LogError(text)
            self.opening_fault = text
        self.count = min(stated, fitting)
        self._end = layout.start + self.count * layout.record

    def read(self, index: int) -> LogFrame:
        """See Source."""
        layout = self._layout
        data = self._stream.read_at(layout.start + index * layout.record, layout.record)
        if len(data) < layout.record:
            raise self.error(index, f"found {len(data)} bytes, expected a record of {layout.record}")
        return read_record(data, layout, index, self.where(index))

    def where(self, index: int) -> str:
        """See Source."""
        return f"{self.path}: record {index}"

    def check_end(self) -> None:
        """See Source; reading on to the end is also what makes gzip compare its checksum."""
        if self._stream.read_at(self._end, 1) and self.opening_fault is None:
            raise LogError(f"{self.path}: found bytes after record {self.count - 1}, expected the file's end")

    def close(self) -> None:
        """See Source."""
        self._stream.close()


def read_record(data: bytes, layout: Layout, index: int, where: str) -> LogFrame:
    """The frame in a record's bytes; LogError if they are not as the layout says, or impossible."""
    offset = layout.before_cameras
    images: list[Image | None] = []
    raw: list[Image] = []
    stamps = []
    for number, expected in enumerate(layout.cameras, start=1):
        what = f"{where}, camera number {number}"
        found = camera_shape(data, offset, what=what)
        if found != expected:
            raise LogError(f"{what}: found {found}, expected {expected} as in record 0")
        offset += CAMERA_HEADER.size
        pixels = np.frombuffer(data, np.uint8, expected.pixel_bytes, offset)
        pixels = pixels.reshape(expected.rows, expected.columns, -1)
        # A copy, so that an image does not keep the record's bytes.
        if expected.type == 0:
            raw.append(pixels[:, :, 0].copy())
        images.append(from_bayer(raw[-1]) if expected.type == 0 else pixels.copy())
        offset += expected.pixel_bytes
        (stamp,) = struct.unpack_from("<d", data, offset)
        stamps.append(checked_stamp(stamp, what=what))
        offset += 8
    if is_empty(np.array(stamps), [image for image in images if image is not None]):
        return empty_frame(index, len(images))
    if layout.stamped:
        stamp = checked_stamp(struct.unpack_from("<d", data)[0] / 1000, what=where)
    else:
        stamp = float(np.mean(stamps))
    poses = _poses(data, offset, layout, where)
    mosaics = tuple(raw) if len(raw) == len(images) else None
    return LogFrame(index, stamp, np.array(stamps), tuple(images), *poses, mosaics)


def _poses(
    data: bytes, offset: int, layout: Layout, where: str
) -> tuple[RecordedPose | None, RecordedPose | None]:
    """The measured and the filtered pose; None for one that is not recorded."""
    poses: list[RecordedPose | None] = [None, None]
    numbers = np.frombuffer(data, "<f8", layout.poses * layout.pose_numbers, offset)
    for k, values in enumerate(numbers.reshape(layout.poses, layout.pose_numbers)):
        what = f"{where}, {('pose', 'filtered pose')[k]}"
        poses[k] = pose_from_record(values[-8:], what=what)
    return poses[0], poses[1]
