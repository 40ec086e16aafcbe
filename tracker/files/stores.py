"""Zarr 2 arrays in an LMDB database, read block by block, trusting nothing.

The LMDB library maps the file to memory and follows whatever number stands in it: a damaged one, or a page
that is missing, ends the whole process. Therefore it has a process of its own, which is asked for values.

Only lists of byte strings, and lists and tables of plain numbers, are decoded, plain or packed by Blosc as
zarr packs them by itself; codecs that could run code (pickle) are refused. What a block unpacks to is bounded
before it is unpacked.
"""

from __future__ import annotations

import json
import math
import os
import struct
import subprocess
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, Literal

import numpy as np

from tracker.checks import naming, optional
from tracker.conventions import Array
from tracker.errors import LogError
from tracker.files import on_error, open_regular, told_of
from tracker.processes import python_command

_READER = """
import lmdb, struct
file = lmdb.open(sys.argv[1], subdir=False, readonly=True, lock=False, max_dbs=0)
about, answers = file.stat(), sys.stdout.buffer
answers.write(struct.pack("<QQ", (file.info()["last_pgno"] + 1) * about["psize"], about["entries"]))
answers.flush()
with file.begin(buffers=True) as values:
    for line in sys.stdin.buffer:
        key, largest = line.split()
        value = values.get(key)
        answers.write(struct.pack("<q", -1 if value is None else len(value)))
        answers.write(value if value is not None and len(value) <= int(largest) else b"")
        answers.flush()
"""
"""Writes how long the file has to be [bytes], and the number of values; then of each key that it reads the
length of the value, -1 where there is none, and the value, where it has no more bytes than asked for."""


class LmdbFile:
    """A database without others in it, open for reading.

    Raises:
        LogError: it is none, it is truncated, or a package is missing.
    """

    def __init__(self, path: Path) -> None:
        for package in ("lmdb", "numcodecs"):  # which are missed here, not at the first value
            optional(package, "datasets", f"{path}: an image store", LogError)
        self._path = path
        with told_of(path), open_regular(path) as file:
            self.size = file.seek(0, 2)
        self._reader = subprocess.Popen(
            python_command(_READER, os.fspath(path)),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            start_new_session=True,  # Ctrl-C is for who asks
        )
        with on_error(self.close):
            expected, self.entries = struct.unpack("<QQ", self._received(16))
            if expected > self.size:
                found = f"found {self.size} bytes, expected at least {expected}"
                raise LogError(f"{path}: {found}: it is truncated")

    def close(self) -> None:
        """End the process."""
        self._reader.kill()
        self._reader.communicate()

    def get(self, key: str, largest: int) -> bytes | None:
        """The value of a key, None where there is none; LogError where it has more than `largest` bytes."""
        assert self._reader.stdin is not None
        try:
            self._reader.stdin.write(f"{key} {largest}\n".encode("ascii"))
            self._reader.stdin.flush()
        except BrokenPipeError as error:
            raise self._damaged(f"no {key}") from error
        (size,) = struct.unpack("<q", self._received(8))
        if size > largest:
            raise self._damaged(f"{size} bytes of {key}, expected at most {largest}")
        return self._received(size) if size >= 0 else None

    def _received(self, size: int) -> bytes:
        assert self._reader.stdout is not None
        content = self._reader.stdout.read(size)
        if len(content) < size:
            raise self._damaged(f"{self.size} bytes that cannot be read")
        return content

    def _damaged(self, found: str) -> LogError:
        return LogError(f"{self._path}: found {found}: it is no LMDB store, or damaged")


MAX_BLOCK = 1 << 29
"""Largest block [bytes], packed and unpacked."""

MAX_NUMBERS = 1 << 25
"""Longest array of numbers; as control steps at 50 Hz, a week."""

_MAX_JSON = 1 << 20  # bytes
_MAX_LEFT_OUT = 1 << 16  # blocks; those that hold nothing but the fill value may be left out
_RAGGED = ("vlen-bytes", "vlen-array")
_PACKER = "blosc"


class StoredArray:
    """A list of byte strings or of numbers, or a table of numbers, in tiles.

    A block is the tiles of the same rows; zarr keeps those of numbers in full size at the edges, too.
    """

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
        self._kept: list[bytes] = []

    @classmethod
    def find(cls, store: LmdbFile, name: str, where: str) -> StoredArray | None:
        """The array, or None where there is none of this name; LogError if it is malformed."""
        return cls(store, name, where) if store.get(f"{name}/.zarray", _MAX_JSON) is not None else None

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, index: int) -> bytes:
        """One of the byte strings; one block is in memory."""
        number, offset = divmod(index, self._tile[0])
        if number != self._number:
            self._kept, self._number = self._strings(number), number
        return self._kept[offset]

    @property
    def ragged(self) -> bool:
        """Whether the items are byte strings."""
        return self._dtype is None

    def numbers(self) -> Array:
        """All numbers; LogError if they are byte strings, or missing or damaged."""
        return np.concatenate([np.zeros((0, *self.shape[1:]), self._dtype), *self.blocks()])

    def blocks(self) -> Iterator[Array]:
        """The numbers in one block after the other; LogError as for `numbers`."""
        if self._dtype is None:
            raise LogError(f"{self._where}: found byte strings, expected numbers")
        ends = [""] if len(self.shape) == 1 else [f".{k}" for k in range(self._tiles[1])]
        for number in range(self._tiles[0]):
            tiles = [self._numbers(f"{number}{end}", self._dtype) for end in ends]
            left = len(self) - number * self._tile[0]
            yield np.concatenate(tiles, axis=-1)[(slice(left), *map(slice, self.shape[1:]))]

    def _strings(self, number: int) -> list[bytes]:
        import numcodecs

        what = f"{self._where}: block {number}"
        data = self._stored(str(number), MAX_BLOCK)
        if data is None:
            raise LogError(f"{what} is missing")
        count = int.from_bytes(data[:4], "little")
        expected = min(self._tile[0], len(self) - number * self._tile[0])
        with naming(f"{what}: found items that are damaged", LogError, LogError, ValueError, SystemError):
            if count > len(data) // 4:  # before a list of that length is made
                raise LogError(f"{count} items stated in {len(data)} bytes")
            items = list(numcodecs.VLenBytes().decode(data))
        if len(items) < expected:
            raise LogError(f"{what}: found {len(items)} items, expected {expected}")
        return items

    def _numbers(self, key: str, dtype: np.dtype[Any]) -> Array:
        """A tile, in its shape."""
        what, size = f"{self._where}: block {key}", math.prod(self._tile)
        data = self._stored(key, size * dtype.itemsize)
        if data is not None:
            if len(data) != size * dtype.itemsize:
                raise LogError(
                    f"{what}: found {len(data)} bytes, expected {size} numbers of {dtype.itemsize}"
                )
            return np.frombuffer(data, dtype).reshape(self._tile, order=self._order)
        if self._fill is None:
            raise LogError(f"{what} is missing")
        try:
            return np.full(self._tile, dtype.type(self._fill), dtype)  # what zarr leaves out
        except (OverflowError, ValueError) as error:
            raise LogError(f"{what}: fill_value: found {self._fill}, expected {dtype}") from error

    def _take(self, meta: dict[str, Any]) -> None:
        self.shape: tuple[int, ...] = tuple(meta["shape"])
        self._tile: tuple[int, ...] = tuple(meta["chunks"])
        sides = (self.shape[0] + 1, *self.shape[1:], *self._tile)
        if meta["zarr_format"] != 2 or not all(isinstance(side, int) and side > 0 for side in sides):
            raise ValueError
        if math.prod(self._tile) > 1 << 24 or len(self.shape) > 2 - (meta["dtype"] == "|O"):
            raise ValueError
        # Of numbers those that are left out are not stored; of pictures each has some bytes.
        most, length = self._store.size if meta["dtype"] == "|O" else MAX_NUMBERS, math.prod(self.shape)
        if length > most:
            raise LogError(f"{self._where}: found {length} items stated, expected at most {most}")
        self._tiles = [-(-side // step) for side, step in zip(self.shape, self._tile, strict=True)]
        most, blocks = max(self._store.entries, _MAX_LEFT_OUT), math.prod(self._tiles)
        if blocks > most:
            raise LogError(f"{self._where}: found {blocks} blocks stated, expected at most {most}")
        filters = [entry["id"] for entry in meta["filters"] or ()]
        self._dtype: np.dtype[Any] | None = None
        if meta["dtype"] != "|O":
            self._dtype = np.dtype(meta["dtype"])
            if filters or self._dtype.kind not in "iufb":
                raise ValueError
        elif len(filters) != 1 or filters[0] not in _RAGGED:
            raise LogError(f"{self._where}: found items coded as {filters}, expected {' or '.join(_RAGGED)}")
        self._order: Literal["C", "F"] = "F" if meta.get("order") == "F" else "C"
        fill = meta["fill_value"]
        self._fill = fill if isinstance(fill, (int, float)) else None
        self._packer = meta["compressor"]
        if self._packer is not None and self._packer["id"] != _PACKER:
            found = str(self._packer["id"])[:40]
            raise LogError(f"{self._where}: found blocks packed by {found!r}, expected {_PACKER} or none")

    def _stored(self, key: str, largest: int) -> bytes | None:
        """What a block unpacks to; None where there is none."""
        data = self._store.get(f"{self._name}/{key}", MAX_BLOCK)
        if data is None or self._packer is None:
            return data
        # Bytes 4 to 8 of a block state what it unpacks to, bytes 12 to 16 its own length.
        stated, length = int.from_bytes(data[4:8], "little"), int.from_bytes(data[12:16], "little")
        with naming(f"{self._where}: block {key}: cannot be unpacked", LogError, Exception):
            if length != len(data) or stated > largest:
                found = f"{len(data)} of {length} bytes, of which a size of {stated} bytes stated"
                raise LogError(f"found {found}, expected at most {largest}")
            import numcodecs

            return bytes(numcodecs.get_codec(self._packer).decode(data))

    def _json(self, key: str) -> dict[str, Any] | None:
        data = self._store.get(f"{self._name}/{key}", _MAX_JSON)
        if data is None:
            return None
        value = None
        with suppress(ValueError, RecursionError):
            value = json.loads(data)
        if not isinstance(value, dict):
            raise LogError(f"{self._where}/{key}: found no JSON object")
        return value
