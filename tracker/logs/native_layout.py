"""How the records of a native log are laid out, found from the records themselves.

    u32 version = 1 | u64 n | n × record
    record = f64 stamp [ms] | 3 × camera | no pose, one, or the measured and the filtered one
    camera = i32 rows | i32 cols | i32 type | u8 continuous | pixels | f64 stamp [s]
    pose   = px py pz qx qy qz qw confidence, in autumn 2020 after a ninth number

The oldest files have neither version nor record stamps. Nothing says which variant a file is, so every
possible one is compared with where the camera's header of the second record is. Numbers are checked
before anything is sized by them.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from tracker.errors import LogError
from tracker.logs.native_stream import Stream
from tracker.logs.source import MAX_SIDE, MIN_SIDE

CAMERAS = 3

CAMERA_HEADER = struct.Struct("<iiiB")

_CHANNELS = {0: 1, 16: 3}
"""Channels by OpenCV's type: Bayer pixels, or BGR."""

_POSES = {"none": (0, 0), "one": (1, 8), "two": (2, 8), "one with time": (1, 9), "two with time": (2, 9)}
"""Count of poses, and of numbers in each, from what is recorded."""


@dataclass(frozen=True)
class CameraShape:
    """What a camera's header says of its pixels."""

    rows: int
    columns: int
    type: int

    @property
    def pixel_bytes(self) -> int:
        """Size of the pixels."""
        return self.rows * self.columns * _CHANNELS[self.type]

    def __str__(self) -> str:
        return f"{self.columns}×{self.rows} px of type {self.type}"


@dataclass(frozen=True)
class Layout:
    """Where everything is in a record."""

    stamped: bool
    """Whether there are a version and stamps of records."""
    cameras: tuple[CameraShape, ...]
    poses: int
    """Number of poses."""
    pose_numbers: int
    """Numbers in a pose."""

    @property
    def start(self) -> int:
        """Offset of the first record."""
        return 12 if self.stamped else 8

    @property
    def before_cameras(self) -> int:
        """Bytes of a record before its first camera."""
        return 8 if self.stamped else 0

    @property
    def record(self) -> int:
        """Size of a record [bytes]."""
        return self.before_cameras + _cameras_size(self.cameras) + 8 * self.poses * self.pose_numbers


def camera_shape(data: bytes, offset: int, *, what: str) -> CameraShape:
    """The shape that the header at this offset states; LogError if it cannot be one."""
    if len(data) < offset + CAMERA_HEADER.size:
        raise LogError(f"{what}: found the end of the file, expected a camera's header")
    rows, columns, kind, continuous = CAMERA_HEADER.unpack_from(data, offset)
    sides = MIN_SIDE <= rows <= MAX_SIDE and MIN_SIDE <= columns <= MAX_SIDE
    if not sides or kind not in _CHANNELS or continuous not in (0, 1):
        raise LogError(
            f"{what}: found {rows} rows, {columns} columns, type {kind}, continuous {continuous}, "
            f"expected {MIN_SIDE} to {MAX_SIDE} rows and columns, type 0 or 16, continuous 0 or 1"
        )
    return CameraShape(rows, columns, kind)


def find_layout(stream: Stream, path: object) -> tuple[Layout, int]:
    """The layout and the stated number of records, which is above 0; LogError if the file is no such log."""
    stamped, count = _header(stream.read_at(0, 20 + CAMERA_HEADER.size), path)
    start = 20 if stamped else 8
    offset = start
    cameras = []
    for number in range(CAMERAS):
        header = stream.read_at(offset, CAMERA_HEADER.size)
        cameras.append(camera_shape(header, 0, what=f"{path}: record 0, camera number {number + 1}"))
        offset += CAMERA_HEADER.size + cameras[-1].pixel_bytes + 8
    shapes = tuple(cameras)
    variants = [Layout(stamped, shapes, *pose) for pose in _POSES.values()]
    # One read past the first record's cameras, as far as the longest variant's next camera.
    tail = stream.read_at(offset, 8 * 18 + 8 + CAMERA_HEADER.size)
    for layout in variants:
        poses = 8 * layout.poses * layout.pose_numbers
        if _continues(tail, poses, layout) or (count == 1 and len(tail) == poses):
            return layout, count
    for layout in variants:  # where the second record's header is damaged
        if not stream.gzipped and stream.largest == layout.start + count * layout.record:
            return layout, count
    raise LogError(
        f"{path}: after the images of record 0 found neither poses and the next record nor the end of the "
        f"log of {count} records: {_shown_size(stream)}, expected a native camera log that is whole"
    )


def _header(head: bytes, path: object) -> tuple[bool, int]:
    """Whether records are stamped, and how many there are."""
    for stamped, offset in ((True, 20), (False, 8)):
        try:
            camera_shape(head, offset, what="")
        except LogError:
            continue
        version, count = struct.unpack_from("<IQ", head) if stamped else (1, *struct.unpack_from("<Q", head))
        if stamped and version != 1:
            raise LogError(f"{path}: found version {version}, expected 1")
        if not count:
            raise LogError(f"{path}: found 0 records stated and some there, expected their number")
        return stamped, count
    raise LogError(
        f"{path}: found {len(head)} bytes that start with {head[:12].hex(' ')}, "
        "expected a camera log: native, gzipped or not, or HDF5"
    )


def _continues(tail: bytes, poses: int, layout: Layout) -> bool:
    """Whether the next record's first camera is where this layout has it."""
    try:
        found = camera_shape(tail, poses + layout.before_cameras, what="")
    except LogError:
        return False
    return found == layout.cameras[0]


def _cameras_size(cameras: tuple[CameraShape, ...]) -> int:
    return sum(CAMERA_HEADER.size + camera.pixel_bytes + 8 for camera in cameras)


def _shown_size(stream: Stream) -> str:
    return "gzipped data" if stream.gzipped else f"{stream.largest} bytes"
