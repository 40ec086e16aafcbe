"""Reads zarr 2 arrays in an LMDB database block by block, without trusting the file.

The LMDB library maps the file to memory and follows any offset in it: a damaged offset or a missing page
crashes the process. It therefore runs in a separate process that is asked for values.

Only lists of byte strings, and lists and tables of plain numbers, are decoded, uncompressed or compressed by
Blosc (zarr's default); codecs that could run code (pickle) are refused. The size of a block is checked before
it is decompressed.
"""

from __future__ import annotations

import json
import math
import os
import struct
import subprocess
from contextlib import suppress
from pathlib import Path
from typing import Any, Literal

import numpy as np

from tracker.checks import naming, optional
from tracker.conventions import Array
from tracker.errors import LogError
from tracker.files import OneAtATime, on_error, open_regular, reading
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
"""Program that writes the file's minimum length [bytes] and the number of values; then, for each key that it
reads, the length of the value (-1 if there is none) and, unless it exceeds the given limit, the value."""


class LmdbFile:
    """An LMDB file without named databases, open for reading; LogError if it is damaged or not a database."""

    def __init__(self, path: Path) -> None:
        for package in ("lmdb", "numcodecs"):  # fail here, not at the first value
            optional(package, "datasets", f"{path}: an image store", LogError)
        self._path, self._alone = path, OneAtATime(path)
        with reading(path), open_regular(path) as file:
            self.size = file.seek(0, 2)
        self._begin()

    def _begin(self) -> None:
        """Start the reader process."""
        self._reader = subprocess.Popen(
            python_command(_READER, os.fspath(self._path)),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            start_new_session=True,  # so that Ctrl-C reaches the parent only
        )
        with on_error(self.close):
            expected, self.entries = struct.unpack("<QQ", self._received(16))
            if expected > self.size:
                found = f"found {self.size} bytes, expected at least {expected}"
                raise LogError(f"{self._path}: {found}: it is truncated")

    def close(self) -> None:
        """End the reader process."""
        self._reader.kill()
        self._reader.communicate()

    def get(self, key: str, largest: int) -> bytes | None:
        """Return the value of a key, or None if there is none; LogError if it exceeds `largest` bytes."""
        assert self._reader.stdin is not None
        with self._alone.lock():
            try:
                self._reader.stdin.write(f"{key} {largest}\n".encode("ascii"))
                self._reader.stdin.flush()
                (size,) = struct.unpack("<q", self._received(8))
                content = self._received(size) if 0 <= size <= largest else None
            except BrokenPipeError as error:
                raise self._damaged(f"no {key}") from error
            except KeyboardInterrupt:  # what is left of the answer would be taken for the next one
                self.close()
                self._begin()
                raise
        if size > largest:
            raise self._damaged(f"{size} bytes of {key}, expected at most {largest}")
        return content

    def _received(self, size: int) -> bytes:
        assert self._reader.stdout is not None
        content = self._reader.stdout.read(size)
        if len(content) < size:
            raise self._damaged(f"{self.size} bytes that cannot be read")
        return content

    def _damaged(self, found: str) -> LogError:
        return LogError(f"{self._path}: found {found}: it is no LMDB store, or damaged")


MAX_BLOCK = 1 << 29
"""Largest block, compressed or not [bytes]."""

MAX_ROWS = 1 << 24
"""Most rows of an array of numbers: four days of control steps at 50 Hz."""

_MAX_JSON = 1 << 20  # bytes
_MAX_LEFT_OUT = 1 << 16  # blocks; zarr may omit blocks that hold only the fill value
_RAGGED = ("vlen-bytes", "vlen-array")
_PACKER = "blosc"


class StoredArray:
    """A list of byte strings or of numbers, or a table of numbers, stored in tiles.

    A block is all tiles of the same rows; zarr stores tiles of numbers at the edges in full size, too.
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
        self._kept: tuple[int, list[bytes]] = -1, []  # a block's number and items, replaced together

    @classmethod
    def find(cls, store: LmdbFile, name: str, where: str) -> StoredArray | None:
        """Return the array, or None if there is none with this name; LogError if it is malformed."""
        return cls(store, name, where) if store.get(f"{name}/.zarray", _MAX_JSON) is not None else None

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, index: int) -> bytes:
        """Return one of the byte strings; one block is kept in memory."""
        number, offset = divmod(index, self._tile[0])
        kept = self._kept
        if number != kept[0]:
            kept = self._kept = number, self._strings(number)
        return kept[1][offset]

    @property
    def ragged(self) -> bool:
        """Whether the items are byte strings."""
        return self._dtype is None

    def numbers(self, axes: int, kinds: str = "iufb", columns: Any = slice(None)) -> Array:
        """Return all numbers, or some `columns` of a table.

        LogError if axes or kind of type differ, or numbers are missing or damaged.
        """
        if self._dtype is None or self._dtype.kind not in kinds:
            found = self._dtype or "byte strings"
            raise LogError(f"{self._where}: found {found}, expected {'whole ' * (kinds == 'iu')}numbers")
        if len(self.shape) != axes:
            raise LogError(f"{self._where}: found shape {self.shape}, expected {axes} axes")
        chosen = np.arange(math.prod(self.shape[1:]))[columns]
        number, inside = np.divmod(chosen, math.prod(self._tile[1:]))
        result = np.empty((len(self), len(chosen)), self._dtype)
        for place in np.ndindex(*self._tiles):
            key = self._separator.join(map(str, place))
            tile = self._numbers(key, self._dtype).reshape(self._tile[0], -1)
            part = result[place[0] * len(tile) :][: len(tile)]
            here = number == sum(place[1:])
            part[:, here] = tile[: len(part), inside[here]]
        return result[:, 0] if axes == 1 else result

    def _strings(self, number: int) -> list[bytes]:
        import numcodecs

        what = f"{self._where}: block {number}"
        data = self._stored(str(number), MAX_BLOCK)
        if data is None:
            raise LogError(f"{what} is missing")
        count = int.from_bytes(data[:4], "little")
        expected = min(self._tile[0], len(self) - number * self._tile[0])
        with naming(f"{what}: found items that are damaged", LogError, LogError, ValueError, SystemError):
            if count > len(data) // 4:  # checked before a list of that length is allocated
                raise LogError(f"{count} items stated in {len(data)} bytes")
            items = list(numcodecs.VLenBytes().decode(data))
        if len(items) < expected:
            raise LogError(f"{what}: found {len(items)} items, expected {expected}")
        return items

    def _numbers(self, key: str, dtype: np.dtype[Any]) -> Array:
        what, size, each = f"{self._where}: block {key}", math.prod(self._tile), dtype.itemsize
        data = self._stored(key, size * each)
        if data is not None:
            if len(data) != size * each:
                raise LogError(f"{what}: found {len(data)} bytes, expected {size} numbers of {each}")
            return np.frombuffer(data, dtype).reshape(self._tile, order=self._order)
        if self._fill is None:
            raise LogError(f"{what} is missing")
        fault = f"{what}: fill_value: found {self._fill}, expected {dtype}"
        with naming(fault, LogError, OverflowError, ValueError):
            return np.full(self._tile, dtype.type(self._fill), dtype)  # a block that zarr omitted

    def _take(self, meta: dict[str, Any]) -> None:
        self.shape: tuple[int, ...] = tuple(meta["shape"])
        self._tile: tuple[int, ...] = tuple(meta["chunks"])
        sides = (self.shape[0] + 1, *self.shape[1:], *self._tile)
        if meta["zarr_format"] != 2 or not all(isinstance(side, int) and side > 0 for side in sides):
            raise ValueError
        if math.prod(self._tile) > 1 << 24 or len(self.shape) > 2 - (meta["dtype"] == "|O"):
            raise ValueError
        # Omitted numbers take no space in the store, but each image has at least one byte.
        most = self._store.size if meta["dtype"] == "|O" else MAX_ROWS
        if self.shape[0] > most:
            raise LogError(f"{self._where}: found {self.shape[0]} items stated, expected at most {most}")
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
        self._order: Literal["C", "F"] = meta.get("order", "C")
        self._separator = meta.get("dimension_separator", ".")
        if self._order not in ("C", "F") or self._separator not in (".", "/"):
            raise ValueError
        fill = meta["fill_value"]
        self._fill = fill if isinstance(fill, (int, float)) else None
        self._packer = meta["compressor"]
        if self._packer is not None and self._packer["id"] != _PACKER:
            found = str(self._packer["id"])[:40]
            raise LogError(f"{self._where}: found blocks packed by {found!r}, expected {_PACKER} or none")

    def _stored(self, key: str, largest: int) -> bytes | None:
        """Return the decompressed content of a block, or None if there is no such block."""
        data = self._store.get(f"{self._name}/{key}", MAX_BLOCK)
        if data is None or self._packer is None:
            return data
        # Bytes 4 to 8 of a block state its decompressed size, bytes 12 to 16 its own length.
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
        with suppress(ValueError, RecursionError):
            if isinstance(value := json.loads(data), dict):
                return value
        raise LogError(f"{self._where}/{key}: found no JSON object")
