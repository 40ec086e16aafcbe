"""Zarr 2 arrays in an LMDB store, read block by block.

Only lists of byte strings and of plain numbers are decoded here; a block's packing is undone by numcodecs.
Codecs that could run code (pickle) are refused.
"""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tracker.conventions import Array
from tracker.errors import LogError, install
from tracker.logs.source import cannot_read

if TYPE_CHECKING:
    import lmdb

MAX_BLOCK = 1 << 29
"""Largest block [bytes], unpacked."""

_PACKERS = ("blosc", "zlib", "gzip", "zstd", "lz4", "bz2", "lzma")
_RAGGED = ("vlen-bytes", "vlen-array")
_PAGE_MAGIC = 0xBEEFC0DE


def open_store(folder: Path) -> lmdb.Environment:
    """The store in `folder`/data.mdb, for reading; LogError if it is damaged or lmdb is missing."""
    try:
        import lmdb
        import numcodecs  # noqa: F401 - so that it is missed here, not at the first image
    except ImportError as error:
        raise LogError(
            f"{folder}: reading image stores needs the optional packages of the extra 'datasets': "
            f"{install('datasets')} ({error})"
        ) from error
    _check_length(folder / "data.mdb")
    try:
        # Without lock file, so that the folder may be read-only.
        return lmdb.open(str(folder), readonly=True, lock=False, create=False, readahead=False)
    except (lmdb.Error, OSError) as error:
        raise LogError(f"{folder}: cannot be opened as an LMDB store: {error}") from error


def _check_length(file: Path) -> None:
    """LMDB maps the file to memory: a page that is missing at its end would end the whole process."""
    try:
        with file.open("rb") as opened:
            pages = [opened.read(4096)]
            size = file.stat().st_size
            page_size = struct.unpack_from("<I", pages[0], 16 + 24)[0] if len(pages[0]) >= 200 else 0
            if not 512 <= page_size <= 65536:
                raise LogError(f"{file}: found {size} bytes that do not start as an LMDB store does")
            opened.seek(page_size)
            pages.append(opened.read(200))
    except OSError as error:
        raise cannot_read(file, error) from error
    for page in pages:
        if len(page) < 200 or struct.unpack_from("<I", page, 16)[0] != _PAGE_MAGIC:
            raise LogError(f"{file}: found no head of an LMDB store")
    # The newer of the two heads counts; after the head's two tables stand the last page and the transaction.
    last, _ = max((struct.unpack_from("<QQ", page, 16 + 120) for page in pages), key=lambda pair: pair[1])
    if (last + 1) * page_size > size:
        raise LogError(
            f"{file}: found {size} bytes, expected at least {(last + 1) * page_size}: it is truncated"
        )


class StoredArray:
    """A one-dimensional array; one block is in memory."""

    def __init__(self, store: lmdb.Environment, name: str, where: str) -> None:
        self._store, self._name, self._where = store, name, f"{where}: {name}"
        self.attributes = self._json(".zattrs") or {}
        meta = self._json(".zarray")
        if meta is None:
            raise LogError(f"{self._where} is missing, expected a data set with images")
        try:
            self._take(meta)
        except (KeyError, TypeError, ValueError, AttributeError, IndexError) as error:
            raise LogError(f"{self._where}: .zarray: found {str(meta)[:200]}, expected zarr 2") from error
        self._number = -1
        self._block: list[bytes] | Array = []

    @classmethod
    def find(cls, store: lmdb.Environment, name: str, where: str) -> StoredArray | None:
        """The array, or None where there is none of this name; LogError if it is malformed."""
        with store.begin(write=False) as transaction:
            there = transaction.get(f"{name}/.zarray".encode("ascii")) is not None
        return cls(store, name, where) if there else None

    def __len__(self) -> int:
        return self._length

    def __getitem__(self, index: int) -> Any:
        """Bytes of an item of a ragged array, or a number."""
        number, offset = divmod(index, self._chunk)
        if number != self._number:
            self._block = self.block(number)
            self._number = number
        return self._block[offset]

    @property
    def blocks(self) -> int:
        """Number of blocks."""
        return -(-self._length // self._chunk)

    @property
    def ragged(self) -> bool:
        """Whether the items are byte strings."""
        return self._dtype is None

    def block(self, number: int) -> list[bytes] | Array:
        """Items of a block; LogError if they are missing or damaged."""
        what = f"{self._where}: block {number}"
        expected = min(self._chunk, self._length - number * self._chunk)
        data = self._get(str(number))
        if data is None and self._fill is not None and self._dtype is not None:
            return np.full(expected, self._fill, self._dtype)  # what zarr leaves out
        if data is None:
            raise LogError(f"{what} is missing")
        data = self._unpacked(data, what)
        items: list[bytes] | Array
        if self._dtype is None:
            items = _split(data, what)
        else:
            if len(data) % self._dtype.itemsize:
                raise LogError(f"{what}: found {len(data)} bytes, expected numbers of {self._dtype.itemsize}")
            items = np.frombuffer(data, self._dtype)
        if len(items) < expected:
            raise LogError(f"{what}: found {len(items)} items, expected {expected}")
        return items[:expected]

    def _take(self, meta: dict[str, Any]) -> None:
        (length,), (chunk,) = meta["shape"], meta["chunks"]
        if meta["zarr_format"] != 2 or not 0 <= length < 1 << 40 or not 0 < chunk <= 1 << 24:
            raise ValueError
        self._length, self._chunk = int(length), int(chunk)
        filters = [entry["id"] for entry in meta["filters"] or ()]
        self._dtype: np.dtype[Any] | None = None
        if meta["dtype"] != "|O":
            self._dtype = np.dtype(meta["dtype"])
            if filters or self._dtype.kind not in "iufb":
                raise ValueError
        elif len(filters) != 1 or filters[0] not in _RAGGED:
            raise LogError(f"{self._where}: found items coded as {filters}, expected {' or '.join(_RAGGED)}")
        fill = meta["fill_value"]
        self._fill = fill if isinstance(fill, (int, float)) else None
        self._packer = meta["compressor"]
        if self._packer is not None and self._packer["id"] not in _PACKERS:
            found = str(self._packer["id"])[:40]
            raise LogError(f"{self._where}: found blocks packed by {found!r}, expected {', '.join(_PACKERS)}")

    def _unpacked(self, data: bytes, what: str) -> bytes:
        if self._packer is None:
            return data
        import numcodecs

        if self._packer["id"] == "blosc" and (
            len(data) < 16
            or int.from_bytes(data[4:8], "little") > MAX_BLOCK
            or int.from_bytes(data[12:16], "little") != len(data)
        ):
            raise LogError(f"{what}: found {len(data)} bytes, expected a block of blosc that is whole")
        try:
            return bytes(numcodecs.get_codec(self._packer).decode(data))
        # Every codec raises errors of its own for damaged data.
        except Exception as error:
            raise LogError(f"{what}: cannot be unpacked: {' '.join(str(error).split())}") from error

    def _get(self, key: str) -> bytes | None:
        import lmdb

        try:
            with self._store.begin(write=False) as transaction:
                value: bytes | None = transaction.get(f"{self._name}/{key}".encode("ascii"))
                return value
        except lmdb.Error as error:
            raise LogError(f"{self._where}/{key}: cannot be read: {error}") from error

    def _json(self, key: str) -> dict[str, Any] | None:
        data = self._get(key)
        if data is None:
            return None
        try:
            value = json.loads(data)
        except (ValueError, RecursionError) as error:
            raise LogError(f"{self._where}/{key}: found no JSON") from error
        if not isinstance(value, dict):
            raise LogError(f"{self._where}/{key}: found no JSON object")
        return value


def _split(data: bytes, what: str) -> list[bytes]:
    """The byte strings of a ragged block: u32 count, then for each u32 length and bytes."""
    if len(data) < 4:
        raise LogError(f"{what}: found {len(data)} bytes, expected a count of items")
    (count,) = struct.unpack_from("<I", data)
    if count > len(data) // 4:
        raise LogError(f"{what}: found {count} items stated in {len(data)} bytes")
    items: list[bytes] = []
    at = 4
    for _ in range(count):
        if at + 4 > len(data):
            raise LogError(f"{what}: found its end after {len(items)} items, expected {count}")
        (length,) = struct.unpack_from("<I", data, at)
        at += 4 + length
        if at > len(data):
            raise LogError(f"{what}: found its end within item {len(items)}")
        items.append(data[at - length : at])
    return items
