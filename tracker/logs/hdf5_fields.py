"""Fields of an HDF5 file, read in blocks, trusting nothing.

Only data that are in the file itself are read, unpacked with filters that come with the HDF5 library: no
links to other files, no external or virtual storage, no plug-ins, no objects.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any

import h5py
import numpy as np

from tracker.conventions import Array, FloatArray
from tracker.errors import LogError

MAX_CHUNK = 1 << 28
"""Largest block [bytes] that a field may be stored in."""

_FILTERS = {
    h5py.h5z.FILTER_DEFLATE: "gzip",
    h5py.h5z.FILTER_SHUFFLE: "shuffle",
    h5py.h5z.FILTER_FLETCHER32: "fletcher32",
}
_ROWS = 512  # rows of a small field that are read at once


@contextlib.contextmanager
def faults_as_log_errors(what: str) -> Iterator[None]:
    """Turn what h5py raises on damaged files into a LogError that starts with `what`."""
    try:
        yield
    except LogError as error:
        raise error if str(error).startswith(what) else LogError(f"{what}: {error}") from error
    # h5py passes on whatever stage of the library's work fails, each with a Python type of its own.
    except (OSError, RuntimeError, ValueError, LookupError, TypeError, ArithmeticError, MemoryError) as error:
        raise LogError(f"{what}: {' '.join(str(error).split()) or type(error).__name__}") from error


def find_field(file: h5py.File, name: str, where: str) -> h5py.Dataset | None:
    """The field at a path such as `object_pose/position`, or None; LogError if it cannot be trusted."""
    item = _find(file, name, where)
    if item is None:
        return None
    what = f"{where}: {name}"
    if not isinstance(item, h5py.Dataset):
        raise LogError(f"{what}: found a group, expected a dataset")
    with faults_as_log_errors(what):
        if item.is_virtual or item.external:
            raise LogError(f"{what}: found data outside the file, expected them inside")
        _check_filters(item, what)
        if item.chunks:
            _check_blocks(item, what)
    return item


def has_group(file: h5py.File, name: str, where: str) -> bool:
    """Whether there is a group at this path."""
    return isinstance(_find(file, name, where), h5py.Group)


def _find(file: h5py.File, name: str, where: str) -> Any:
    with faults_as_log_errors(f"{where}: {name}"):
        item: Any = file
        for part in name.split("/"):
            if not isinstance(item, h5py.Group) or part not in item:
                return None
            if not isinstance(item.get(part, getlink=True), h5py.HardLink):
                raise LogError(f"{where}: {name}: found a link, expected the data themselves")
            item = item[part]
        return item


def _check_filters(dataset: h5py.Dataset, what: str) -> None:
    properties = dataset.id.get_create_plist()
    for number in range(properties.get_nfilters()):
        code, _, settings, _ = properties.get_filter(number)
        if code not in _FILTERS:
            known = ", ".join(_FILTERS.values())
            raise LogError(f"{what}: found data packed with filter {code}, expected {known} or none")
        # Checksums are of what is packed, not of how: a damaged setting would scramble the pixels unnoticed.
        size = dataset.dtype.itemsize
        if code == h5py.h5z.FILTER_SHUFFLE and settings != (size,):
            raise LogError(f"{what}: found bytes shuffled by {settings}, expected {(size,)}")


def _check_blocks(dataset: h5py.Dataset, what: str) -> None:
    block = _product(dataset.chunks) * max(1, int(dataset.dtype.itemsize))
    if not 0 < block <= MAX_CHUNK:
        raise LogError(f"{what}: found blocks of {dataset.chunks}, expected at most {MAX_CHUNK} bytes")
    stored = int(dataset.id.get_storage_size())
    # Where damage hides that blocks are packed, the library takes them for whole and reads beyond their end.
    if not dataset.id.get_create_plist().get_nfilters() and stored % block:
        raise LogError(f"{what}: found {stored} bytes stored, expected blocks of {block}")


def _product(numbers: tuple[int, ...]) -> int:
    result = 1
    for number in numbers:
        result *= int(number)
    return result


def read_small(file: h5py.File, name: str, size: int, where: str) -> FloatArray | None:
    """A field of `size` numbers, flat, as float64; None where there is none; LogError if it is another."""
    field = find_field(file, name, where)
    if field is None:
        return None
    if field.dtype.kind not in "fiu" or field.dtype.itemsize > 8 or _product(field.shape or ()) != size:
        raise LogError(f"{where}: {name}: found {_shown(field)}, expected {size} numbers")
    with faults_as_log_errors(f"{where}: {name}"):
        return np.asarray(field[()], dtype=np.float64).ravel()


class Rows:
    """A field with a few numbers for each frame; a block of rows at a time is in memory."""

    def __init__(self, field: h5py.Dataset, width: int, what: str) -> None:
        """Args: a field of shape (n, width), or (n,) where width is 1; LogError if it is another."""
        shape = field.shape or ()
        if not shape or _product(shape[1:]) != width or field.dtype not in (np.float64, np.bool_, np.uint8):
            raise LogError(f"{what}: found {_shown(field)}, expected {width} numbers for each frame")
        self._field, self._width, self._what = field, width, what
        self._start = 0
        self._block: FloatArray = np.empty((0, width))

    def __len__(self) -> int:
        return int(self._field.shape[0])

    def __getitem__(self, index: int) -> FloatArray:
        """(width,) numbers of a frame."""
        if not self._start <= index < self._start + len(self._block):
            start = index - index % _ROWS
            with faults_as_log_errors(self._what):
                rows: Array = self._field[start : start + _ROWS]
                self._block = np.asarray(rows, dtype=np.float64).reshape(-1, self._width)
            self._start = start
        result: FloatArray = self._block[index - self._start]
        return result


def _shown(field: h5py.Dataset) -> str:
    return f"{field.dtype} of shape {field.shape}"
