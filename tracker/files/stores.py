"""Zarr 2 arrays in an LMDB database, read block by block, trusting nothing.

The LMDB library maps the file to memory and follows whatever number stands in it: a damaged one, or a page
that is missing, ends the whole process. Here pages are read, and every number is compared with the file; a
process of its own that may end with the library would take as many lines, and hand every image on by a pipe.

    file  = page 0, page 1 (heads, of which the newer counts), pages of the tree, pages of large values
    page  = u64 number | 2 bytes | u16 kind | u16 end of the offsets | 2 bytes | u16 offsets of nodes …
    node  = u32 size | u16 marks | u16 length of the key | key | data, or where they start
    node of a branch = 48 bits of the page below | u16 length of the key | the least key there

Of arrays only lists of byte strings and of plain numbers are decoded, plain or packed by Blosc as zarr packs
them by itself; codecs that could run code (pickle) are refused. What a block unpacks to is bounded before it
is unpacked.
"""

from __future__ import annotations

import json
import struct
from bisect import bisect_left, bisect_right
from pathlib import Path
from typing import Any, Literal

import numpy as np

from tracker.conventions import Array
from tracker.errors import LogError, install
from tracker.files import open_regular, told_of

_PAGE_HEAD = 16
_MAGIC, _VERSION = 0xBEEFC0DE, 1
_HEAD = struct.Struct("<II16x I44x 4xHH24xQQ QQ")
"""Magic, version; of the free pages' table the page size; of the main one marks, depth, entries and root;
number of the last page, of the transaction."""
_NODE = struct.Struct("<HHHH")
_BRANCH, _LEAF, _LARGE = 1, 2, 4  # kinds of pages
_ELSEWHERE = 1  # mark of a node whose data are on pages of their own
_MAX_DEPTH = 32
_NO_PAGE = 2**64 - 1


class LmdbFile:
    """A database without others in it, open for reading; LogError where it is none, or truncated."""

    def __init__(self, path: Path) -> None:
        self._path = path
        with told_of(path):
            self._file = open_regular(path)
            self.size = self._file.seek(0, 2)
        try:
            self._open()
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def get(self, key: str, largest: int) -> bytes | None:
        """The value of a key, None where there is none; LogError where it has more than `largest` bytes."""
        sought, number = key.encode("ascii"), self._root
        for _ in range(_MAX_DEPTH):
            if number == _NO_PAGE:
                return None
            page = self._page(number)
            keys, nodes = self._nodes(page, number)
            if _kind(page) & _LEAF:
                place = bisect_left(keys, sought)
                there = place < len(keys) and keys[place] == sought
                return self._value(page, nodes[place], number, largest) if there else None
            # The first key of a branch is not there: it holds all that is less than the second.
            low, middle, high, _ = _NODE.unpack_from(page, nodes[max(0, bisect_right(keys, sought, 1) - 1)])
            number = low | middle << 16 | high << 32
        raise self._damaged(f"a tree deeper than {_MAX_DEPTH} pages")

    def _open(self) -> None:
        head = self._read(0, _PAGE_HEAD + _HEAD.size)
        size = _HEAD.unpack_from(head, _PAGE_HEAD)[2] if len(head) == _PAGE_HEAD + _HEAD.size else 0
        if not 512 <= size <= 65536 or size & (size - 1):
            raise self._damaged(f"{self.size} bytes that do not start as an LMDB store does")
        self._page_size = size
        heads = [_HEAD.unpack_from(self._page(number), _PAGE_HEAD) for number in (0, 1)]
        if any(head[:2] != (_MAGIC, _VERSION) for head in heads):
            raise self._damaged("no head of an LMDB store")
        *_, marks, _, self.entries, self._root, last, _ = max(heads, key=lambda head: int(head[-1]))
        if marks:
            raise self._damaged(f"a table of kind {marks}, expected a plain one")
        expected = (last + 1) * size
        if expected > self.size:
            found = f"found {self.size} bytes, expected at least {expected}"
            raise LogError(f"{self._path}: {found}: it is truncated")

    def _nodes(self, page: bytes, number: int) -> tuple[list[bytes], list[int]]:
        """Keys of a page's nodes in order, and where the nodes are in the page."""
        (end,) = struct.unpack_from("<H", page, 12)
        if _kind(page) not in (_BRANCH, _LEAF) or not _PAGE_HEAD < end <= len(page) or end % 2:
            raise self._damaged(f"page {number}, expected nodes")
        nodes = list(struct.unpack_from(f"<{(end - _PAGE_HEAD) // 2}H", page, _PAGE_HEAD))
        keys = []
        for node in nodes:
            if not end <= node <= len(page) - _NODE.size:
                raise self._damaged(f"page {number}: a node at {node}")
            *_, length = _NODE.unpack_from(page, node)
            keys.append(page[node + _NODE.size : node + _NODE.size + length])
        return keys, nodes

    def _value(self, page: bytes, node: int, number: int, largest: int) -> bytes:
        low, high, marks, length = _NODE.unpack_from(page, node)
        size, start = low | high << 16, node + _NODE.size + length
        if marks not in (0, _ELSEWHERE) or size > largest:
            raise self._damaged(f"page {number}: {size} bytes of kind {marks}, expected at most {largest}")
        if not marks:
            value = page[start : start + size]
        elif start + 8 <= len(page):
            (first,) = struct.unpack_from("<Q", page, start)
            if not _kind(self._page(first)) & _LARGE:
                raise self._damaged(f"page {first}, expected a large value")
            value = self._read(first * self._page_size + _PAGE_HEAD, size)
        else:
            value = b""
        if len(value) < size:
            raise self._damaged(f"page {number}: {len(value)} bytes, expected {size}")
        return value

    def _page(self, number: int) -> bytes:
        page = self._read(number * self._page_size, self._page_size)
        if len(page) < self._page_size or struct.unpack_from("<Q", page)[0] != number:
            raise self._damaged(f"page {number} missing")
        return page

    def _read(self, offset: int, size: int) -> bytes:
        if offset >= self.size:
            return b""
        with told_of(self._path):
            self._file.seek(offset)
            return self._file.read(min(size, self.size - offset))

    def _damaged(self, found: str) -> LogError:
        return LogError(f"{self._path}: found {found}: it is no LMDB store, or damaged")


def _kind(page: bytes) -> int:
    (marks,) = struct.unpack_from("<H", page, 10)
    return int(marks) & 0x2F


MAX_BLOCK = 1 << 29
"""Largest block [bytes], packed and unpacked."""

MAX_NUMBERS = 1 << 27
"""Longest array of numbers; as control steps at 50 Hz, a month."""

_MAX_JSON = 1 << 20  # bytes
_MAX_LEFT_OUT = 1 << 16  # blocks; those that hold nothing but the fill value may be left out
_RAGGED = ("vlen-bytes", "vlen-array")
_PACKER = "blosc"


def open_store(folder: Path) -> LmdbFile:
    """The store in `folder`/data.mdb, for reading; LogError if it is damaged or numcodecs is missing."""
    try:
        import numcodecs  # noqa: F401 - so that it is missed here, not at the first image
    except ImportError as error:
        raise LogError(
            f"{folder}: reading image stores needs the optional packages of the extra 'datasets': "
            f"{install('datasets')} ({error})"
        ) from error
    return LmdbFile(folder / "data.mdb")


class StoredArray:
    """A one-dimensional array; one block is in memory."""

    def __init__(self, store: LmdbFile, name: str, where: str) -> None:
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
    def find(cls, store: LmdbFile, name: str, where: str) -> StoredArray | None:
        """The array, or None where there is none of this name; LogError if it is malformed."""
        return cls(store, name, where) if store.get(f"{name}/.zarray", _MAX_JSON) is not None else None

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
    def chunk(self) -> int:
        """Number of items in a block."""
        return self._chunk

    @property
    def ragged(self) -> bool:
        """Whether the items are byte strings."""
        return self._dtype is None

    def block(self, number: int) -> list[bytes] | Array:
        """Items of a block; LogError if they are missing or damaged."""
        what = f"{self._where}: block {number}"
        expected = min(self._chunk, self._length - number * self._chunk)
        data = self._store.get(f"{self._name}/{self._key(number)}", MAX_BLOCK)
        if data is None and self._fill is not None and self._dtype is not None:
            try:
                return np.full(expected, self._dtype.type(self._fill), self._dtype)  # what zarr leaves out
            except (OverflowError, ValueError) as error:
                raise LogError(f"{what}: fill_value: found {self._fill}, expected {self._dtype}") from error
        if data is None:
            raise LogError(f"{what} is missing")
        width = 0 if self._dtype is None else self._dtype.itemsize
        data = self._unpacked(data, width * self._chunk or MAX_BLOCK, what)
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

    def _key(self, number: int) -> str:
        return str(number)

    def _take(self, meta: dict[str, Any]) -> None:
        (length,), (chunk,) = meta["shape"], meta["chunks"]
        whole = isinstance(length, int) and isinstance(chunk, int)
        if meta["zarr_format"] != 2 or not whole or length < 0 or not 0 < chunk <= 1 << 24:
            raise ValueError
        # Of numbers those that are left out are not stored; of pictures each has some bytes.
        most = self._store.size if meta["dtype"] == "|O" else MAX_NUMBERS
        if length > most:
            raise LogError(f"{self._where}: found {length} items stated, expected at most {most}")
        self._length, self._chunk = int(length), int(chunk)
        most = max(self._store.entries, _MAX_LEFT_OUT)
        if self.blocks > most:
            raise LogError(f"{self._where}: found {self.blocks} blocks stated, expected at most {most}")
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
        if self._packer is not None and self._packer["id"] != _PACKER:
            found = str(self._packer["id"])[:40]
            raise LogError(f"{self._where}: found blocks packed by {found!r}, expected {_PACKER} or none")

    def _unpacked(self, data: bytes, largest: int, what: str) -> bytes:
        if self._packer is None:
            return data
        # Bytes 4 to 8 of a block state what it unpacks to, bytes 12 to 16 its own length.
        stated, length = int.from_bytes(data[4:8], "little"), int.from_bytes(data[12:16], "little")
        try:
            if length != len(data) or stated > largest:
                found = f"{len(data)} of {length} bytes, of which a size of {stated} bytes stated"
                raise LogError(f"found {found}, expected at most {largest}")
            import numcodecs

            return bytes(numcodecs.get_codec(self._packer).decode(data))
        except Exception as error:  # whatever it stumbles over
            raise LogError(f"{what}: cannot be unpacked: {' '.join(str(error).split())}") from error

    def _json(self, key: str) -> dict[str, Any] | None:
        data = self._store.get(f"{self._name}/{key}", _MAX_JSON)
        if data is None:
            return None
        try:
            value = json.loads(data)
        except (ValueError, RecursionError) as error:
            raise LogError(f"{self._where}/{key}: found no JSON") from error
        if not isinstance(value, dict):
            raise LogError(f"{self._where}/{key}: found no JSON object")
        return value


class StoredRows(StoredArray):
    """A two-dimensional array of numbers, of which one block of rows is in memory.

    Its blocks are those of a one-dimensional array: zarr keeps them in full size at the edges, too.
    """

    def rows(self, number: int) -> Array:
        """(k, width) of one block of rows; LogError if they are missing or damaged."""
        first = number * self._across
        tiles = [self.block(first + k) for k in range(self._across)]
        shaped = [np.reshape(tile, self._tile, order=self._order) for tile in tiles]
        return np.concatenate(shaped, axis=1)[: self.shape[0] - number * self._tile[0], : self.shape[1]]

    @property
    def row_blocks(self) -> int:
        """Number of blocks of rows."""
        return -(-self.shape[0] // self._tile[0])

    def _key(self, number: int) -> str:
        return ".".join(map(str, divmod(number, self._across)))

    def _take(self, meta: dict[str, Any]) -> None:
        (rows, width), (deep, wide) = meta["shape"], meta["chunks"]
        if not all(isinstance(k, int) and k > 0 for k in (rows + 1, width, deep, wide)):
            raise ValueError
        self.shape: tuple[int, int] = (rows, width)
        self._tile: tuple[int, int] = (deep, wide)
        self._across: int = -(-width // wide)
        self._order: Literal["C", "F"] = "F" if meta.get("order") == "F" else "C"
        size = deep * wide
        super()._take({**meta, "shape": [self.row_blocks * self._across * size], "chunks": [size]})
        if self.ragged:
            raise ValueError


def _split(data: bytes, what: str) -> list[bytes]:
    """The byte strings of a ragged block, which starts with their number."""
    import numcodecs

    count = int.from_bytes(data[:4], "little")
    try:
        if count > len(data) // 4:  # before a list of that length is made
            raise LogError(f"{count} items stated in {len(data)} bytes")
        return list(numcodecs.VLenBytes().decode(data))
    except (LogError, ValueError, SystemError) as error:
        raise LogError(f"{what}: found items that are damaged: {error}") from error
