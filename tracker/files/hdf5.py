"""Reads HDF5 files without trusting them, and writes them safely.

Only data in the file itself are read, with the filters that come with the HDF5 library: no links to other
files, no external or virtual storage, no plug-ins, no objects. Type, shape and the number of stored bytes
are checked before anything is read. Strings must have fixed length: those of variable length are stored in a
heap without a checksum, and a damaged heap can make the library search forever.

If the disk is full while a file is written, the library loses track of its open objects, and crashes
the process when they are closed, or earlier. `Disk` keeps what the disk refuses in memory, so that the
library can finish and the error can be reported.
"""

import contextlib
import io
import itertools
import math
import os
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from tracker.checks import described, naming
from tracker.conventions import Array
from tracker.errors import LogError, TrackerError, message
from tracker.files import open_regular, reading

MAX_CHUNK = 1 << 28
"""Size of the largest valid chunk of a dataset [bytes]."""

TYPES = {
    "f": "floating-point numbers",
    "fiu": "numbers",
    "iu": "whole numbers",
    "u": "unsigned numbers",
    "b": "bool",
    "S": "texts of fixed length",
}
"""NumPy's type letters, and their names in messages."""

_FILTERS = {
    h5py.h5z.FILTER_DEFLATE: "gzip",
    h5py.h5z.FILTER_SHUFFLE: "shuffle",
    h5py.h5z.FILTER_FLETCHER32: "fletcher32",
}
_MAX_RATIO = 1032  # deflate packs at most this many bytes into one
_MAX_ATTRIBUTE = 1 << 20  # bytes
_END_OFFSET = {0: 40, 1: 44, 2: 28, 3: 28}
"""Offset of the file's stated length, by the version of the superblock."""


@contextlib.contextmanager
def faults_as_log_errors(what: str) -> Iterator[None]:
    """Turn errors raised when damaged files are read into a LogError that starts with `what`."""
    try:
        yield
    except TrackerError as error:
        if isinstance(error, LogError) and str(error).startswith(what):
            raise
        raise LogError(f"{what}: {error}") from error
    # The type of h5py's error depends on the stage at which the library fails.
    except (OSError, RuntimeError, ValueError, LookupError, TypeError, ArithmeticError, MemoryError) as error:
        why = message(error)[:200]
        raise LogError(f"{what}: cannot be read, expected a whole HDF5 file: {why}") from error


def open_file(path: str | os.PathLike[str]) -> h5py.File:
    """Open a regular file for reading; OSError or any error of h5py if it is not an HDF5 file."""
    open_regular(path).close()  # the library would wait for a pipe's writer
    # Reading needs no lock, since files are replaced whole; network drives often have no locks.
    try:
        return h5py.File(path, "r", locking=False)
    except OSError as error:
        if "locking flag" not in str(error):
            raise
        return h5py.File(path, "r")  # this process has it open with locks


def check_stated_end(path: Path) -> str | None:
    """Return a message if the file is longer than it states, else None; LogError if it is shorter."""
    with reading(path), open_regular(path) as file:
        head = file.read(64)
        size = os.fstat(file.fileno()).st_size
    if len(head) < 64:
        raise LogError(f"{path}: found {size} bytes, expected an HDF5 file")
    if head[8] not in _END_OFFSET:  # a newer version than this program knows; the library decides
        return None
    (stated,) = struct.unpack_from("<Q", head, _END_OFFSET[head[8]])
    fault = f"{path}: found {size} bytes, expected the {stated} that the file states"
    if size < stated:
        raise LogError(fault)
    return fault if size > stated else None


def find(file: Any, name: str) -> h5py.Dataset | None:
    """Return the dataset at a path, unread, or None; LogError if it is unsafe to read or not a dataset."""
    with faults_as_log_errors(f"/{name}"):
        item = _item(file, name)
        if item is None:
            return None
        if not isinstance(item, h5py.Dataset):
            raise LogError(f"found a {type(item).__name__.lower()}, expected a dataset")
        if item.is_virtual or item.external:
            raise LogError("found data outside the file, expected them inside")
        _check_stored(item)
        return item


def has_group(file: Any, name: str) -> bool:
    """Whether there is a group at a path."""
    with faults_as_log_errors(f"/{name}"):
        return isinstance(_item(file, name), h5py.Group)


def dataset(file: Any, name: str) -> h5py.Dataset:
    """Return the dataset as `find` does; LogError if there is none."""
    found = find(file, name)
    if found is None:
        raise LogError(f"/{name}: found nothing, expected a dataset")
    return found


def array(file: Any, name: str, shape: tuple[int, ...], kinds: str) -> Array:
    """Return a dataset's `values`; LogError unless it has this shape and a type of `kinds`, one of TYPES."""
    stored = dataset(file, name)
    if stored.dtype.kind not in kinds or stored.shape != shape:
        raise LogError(f"/{name}: found {described(stored)}, expected {TYPES[kinds]} of shape {shape}")
    with faults_as_log_errors(f"/{name}"):
        return values(stored)


def values(stored: h5py.Dataset, stop: int | None = None) -> Array:
    """Read a dataset, or its rows before `stop`; LogError if chunks are missing, or not of their size.

    The library fills in zeros for what was never written.
    """
    if stored.chunks:
        sides = stored.shape if stop is None else (min(stop, stored.shape[0]), *stored.shape[1:])
        size, there = math.prod(sides) * stored.dtype.itemsize, int(stored.id.get_storage_size())
        if size > _MAX_RATIO * there:
            raise LogError(f"found {there} bytes stored, expected enough for {size}")
        steps = zip(sides, stored.chunks, strict=True)
        for offset in itertools.product(*(range(0, side, step) for side, step in steps)):
            unpacked(stored, offset)
    return np.asarray(stored[()] if stop is None else stored[:stop])


def attribute(item: Any, name: str, kinds: str, *, single: bool = True) -> Array:
    """Read an attribute: a single value of shape (), or a list.

    LogError: there is none, or its type (`kinds`, a key of TYPES), shape or size is wrong.
    """
    expected = TYPES[kinds] + ("" if single else ", a list of them")
    if name not in item.attrs:
        raise LogError(f"{name}: found no such attribute, expected {expected}")
    stored = item.attrs.get_id(name)
    # Check the type before reading: the library crashes on damaged strings of variable length.
    fits = stored.shape in ((), (1,)) if single else len(stored.shape) == 1
    if stored.dtype.kind not in kinds or not fits:
        raise LogError(f"{name}: found {described(stored)}, expected {expected}")
    if math.prod(stored.shape) * stored.dtype.itemsize > _MAX_ATTRIBUTE:
        raise LogError(f"{name}: found {described(stored)}, expected at most {_MAX_ATTRIBUTE} bytes")
    value = np.asarray(item.attrs[name])
    return value.reshape(()) if single else value


def text(file: Any, key: str) -> str:
    """Return the text in an attribute; LogError if there is none."""
    return decoded(attribute(file, key, "S"))[0]


def text_of(path: str | os.PathLike[str], key: str) -> str | None:
    """Return the text in a file's attribute; None if there is none, or the file is damaged or not HDF5."""
    with contextlib.suppress(LogError), faults_as_log_errors(""), open_file(path) as file:
        return text(file, key)
    return None  # the function that opens the file later reports what is wrong


def encoded(texts: str | list[str]) -> Array:
    """Encode texts as an array (k,) of fixed-length UTF-8, or a single text as an array of shape ()."""
    contents = np.char.encode(np.array(texts, np.str_), "utf-8")
    return contents.astype(f"S{contents.dtype.itemsize or 1}")


def decoded(texts: Array) -> list[str]:
    """Decode an array of UTF-8 to texts; UnicodeDecodeError if it is not UTF-8."""
    return [bytes(text).decode("utf-8") for text in texts.ravel().tolist()]


def filters_of(dataset: h5py.Dataset) -> tuple[int, ...]:
    """Return the codes of a dataset's filters, in the order in which they are applied on writing."""
    properties = dataset.id.get_create_plist()
    return tuple(properties.get_filter(number)[0] for number in range(properties.get_nfilters()))


def unpacked(stored: h5py.Dataset, offset: tuple[int, ...]) -> bytes:
    """Decompress the chunk at an offset, without unshuffling it or verifying its checksum.

    The HDF5 library itself would allocate any decompressed size, up to a thousand times the chunk's.
    LogError: the decompressed size is wrong, or the chunk is damaged; any error of h5py: there is none.
    """
    filters, whole = filters_of(stored), math.prod(stored.chunks) * stored.dtype.itemsize
    sums = [4 * (code == h5py.h5z.FILTER_FLETCHER32) for code in filters]  # bytes of checksums
    skipped, read = stored.id.read_direct_chunk(offset)
    content = bytes(read)
    for place in reversed(range(len(filters))):
        if skipped >> place & 1:
            continue
        if filters[place] == h5py.h5z.FILTER_DEFLATE:
            content = _inflated(content, whole + sum(sums[:place]))
        content = content[: len(content) - sums[place]]
    if len(content) != whole:
        raise LogError(f"at {offset}: found {len(content)} bytes, expected {whole}")
    return content


def _inflated(packed: bytes, largest: int) -> bytes:
    unpacker = zlib.decompressobj()
    with naming("found a block that cannot be unpacked", LogError, zlib.error):
        content = unpacker.decompress(packed, largest + 1)
    if len(content) > largest or not unpacker.eof:
        raise LogError(f"found a block that unpacks to {len(content)} bytes or more, expected {largest}")
    return content


def _item(file: Any, name: str) -> Any:
    """Return the item at a path, or None; LogError if the path leads through a link."""
    item: Any = file
    for part in name.split("/"):
        # Check the link before following it, and without testing whether its target exists.
        if not isinstance(item, h5py.Group) or not item.id.links.exists(part.encode("utf-8")):
            return None
        if not isinstance(item.get(part, getlink=True), h5py.HardLink):
            raise LogError("found a link, expected the data themselves")
        item = item[part]
    return item


def _check_stored(dataset: h5py.Dataset) -> None:
    """Raise LogError for filters from plug-ins, chunks that are too large or truncated, or nothing stored."""
    properties, size = dataset.id.get_create_plist(), int(dataset.dtype.itemsize)
    for number in range(properties.get_nfilters()):
        code, _, settings, _ = properties.get_filter(number)
        if code not in _FILTERS:
            known = ", ".join(_FILTERS.values())
            raise LogError(f"found data packed with filter {code}, expected {known} or none")
        # Checksums do not cover filter settings: a damaged setting would scramble the pixels unnoticed.
        if code == h5py.h5z.FILTER_SHUFFLE and settings != (size,):
            raise LogError(f"found bytes shuffled by {settings}, expected {(size,)}")
    stored = int(dataset.id.get_storage_size())
    if not dataset.chunks:
        whole = (dataset.size or 0) * dataset.id.get_type().get_size()  # NumPy's size differs for strings
        if stored < whole:
            raise LogError(f"found {stored} bytes stored, expected enough for {whole}")
        return
    block = math.prod(dataset.chunks) * max(1, size)
    if not 0 < block <= MAX_CHUNK:
        raise LogError(f"found blocks of {dataset.chunks}, expected at most {MAX_CHUNK} bytes")
    # If damage hides that chunks are compressed, the library reads beyond their end.
    if not properties.get_nfilters() and stored % block:
        raise LogError(f"found {stored} bytes stored, expected blocks of {block}")


class Disk(io.FileIO):
    """The new file that h5py writes to, `uninterrupted`; it keeps what a full disk refuses in memory."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        super().__init__(path, "xb+")
        self._at = self._end = 0
        self._kept: list[tuple[int, bytes]] = []
        self.fault: OSError | None = None
        """The first error of the disk, or None."""

    def seek(self, offset: int, origin: int = os.SEEK_SET) -> int:
        """Move to an offset from the beginning, or from the end of the file."""
        self._at = offset + (self._end if origin == os.SEEK_END else 0)
        return self._at

    def write(self, data: Any) -> int:
        """Write all data; to memory once the disk has refused any."""
        content, done = bytes(data), 0
        try:
            while self.fault is None and done < len(content):
                super().seek(self._at + done)
                done += super().write(content[done:])
        except OSError as error:
            self.fault = error
        if self.fault is not None:
            self._kept.append((self._at, content))
        self._at += len(content)
        self._end = max(self._end, self._at)
        return len(content)

    def readinto(self, buffer: Any) -> int:
        """Read written data back, from disk or from memory."""
        start, size = self._at, min(len(buffer), self._end - self._at)
        super().seek(start)
        there = super().read(size)
        content = bytearray(there.ljust(size, b"\0"))
        for at, kept in self._kept:
            first, last = max(start, at), min(start + size, at + len(kept))
            if first < last:
                content[first - start : last - start] = kept[first - at : last - at]
        buffer[:size] = content
        return size

    def truncate(self, size: int | None = None) -> int:
        """Set the file's length; None: up to the current position."""
        size = self._at if size is None else size
        try:
            if self.fault is None:
                super().truncate(size)
        except OSError as error:
            self.fault = error
        self._end = size
        return size
