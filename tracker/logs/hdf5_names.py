"""The names of the cameras in an HDF5 log.

Strings of variable length lie in a heap of the file, and in a damaged heap the HDF5 library reads beyond its
memory: it ends the process. Therefore these few bytes are read here.
"""

from __future__ import annotations

import struct
from pathlib import Path

import h5py

from tracker.errors import LogError
from tracker.logs.checked_hdf5 import faults_as_log_errors
from tracker.logs.source import cannot_read

_MAX_NAME = 64
_MAX_HEAP = 1 << 20
_REFERENCE = struct.Struct("<IQI")  # length, address of the heap, number in it
_HEAP_HEAD = struct.Struct("<4sB3xQ")
_OBJECT_HEAD = struct.Struct("<HH4xQ")


def read_names(field: h5py.Dataset, count: int, path: Path) -> tuple[str, ...]:
    """The names in the field `camera_names`; LogError if they are not `count` different ones."""
    what = f"{path}: camera_names"
    with faults_as_log_errors(what):
        kind = field.id.get_type()
        text = isinstance(kind, h5py.h5t.TypeStringID)
        fixed = text and not kind.is_variable_str()
        variable = (text and not fixed) or isinstance(kind, h5py.h5t.TypeVlenID)
        # As the type of a reference h5py gives its size in memory.
        size = _REFERENCE.size if variable else int(kind.get_size())
        offset = field.id.get_offset()
        if field.shape != (count,) or not (fixed or variable) or size > _MAX_NAME or offset is None:
            raise LogError(f"found {field.dtype} of shape {field.shape}, expected {count} names")
        if field.id.get_storage_size() != count * size:
            raise LogError(f"found {field.id.get_storage_size()} bytes, expected {count * size}")
    try:
        data = _bytes_at(path, offset, count * size)
        parts = [data[k * size : (k + 1) * size] for k in range(count)]
        found = parts if fixed else [_from_heap(path, part) for part in parts]
        names = tuple(name.rstrip(b"\0").decode("ascii") for name in found)
    except (struct.error, UnicodeDecodeError, LogError) as error:
        raise LogError(f"{what}: found damaged names ({error}), expected {count}") from error
    if len(set(names)) < count or not all(name.isidentifier() for name in names):
        raise LogError(f"{what}: found {', '.join(names)!r}, expected {count} different names")
    return names


def _from_heap(path: Path, reference: bytes) -> bytes:
    """The string that a reference means."""
    length, address, wanted = _REFERENCE.unpack(reference)
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
        if number == wanted and number and length <= stored:
            return heap[at : at + length]
        if number == 0:  # what is free
            break
        at += -(-stored // 8) * 8
    raise LogError("a name that the heap does not hold")


def _bytes_at(path: Path, offset: int, size: int) -> bytes:
    try:
        with path.open("rb") as file:
            if offset >= file.seek(0, 2):
                raise LogError("beyond the end of the file")
            file.seek(offset)
            return file.read(size)
    except OSError as error:
        raise cannot_read(path, error) from error
