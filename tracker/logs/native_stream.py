"""The bytes of a native log, plain or gzipped, by offset."""

from __future__ import annotations

import gzip
import os
import zlib
from pathlib import Path
from typing import BinaryIO, Protocol

from tracker.errors import LogError
from tracker.logs.source import cannot_read

GZIP_MAGIC = b"\x1f\x8b"

_MAX_RATIO = 1032
"""Deflate packs at most this many bytes into one."""

_PIECE = 1 << 20  # bytes that are skipped at once


class Stream(Protocol):
    """Bytes by offset."""

    largest: int
    """The content has at most this many bytes; exactly, unless it is gzipped."""
    gzipped: bool

    def read_at(self, offset: int, size: int) -> bytes:
        """Up to `size` bytes, fewer only at the end; LogError where the file is damaged."""

    def close(self) -> None:
        """Close the file."""


class PlainStream:
    """An uncompressed file."""

    gzipped = False

    def __init__(self, path: Path) -> None:
        self._path = path
        self._file = path.open("rb")
        self.largest = os.fstat(self._file.fileno()).st_size

    def read_at(self, offset: int, size: int) -> bytes:
        """See Stream."""
        try:
            self._file.seek(offset)
            return self._file.read(size)
        except OSError as error:
            raise cannot_read(self._path, error) from error

    def close(self) -> None:
        """See Stream."""
        self._file.close()


class GzipStream:
    """A gzipped file: reading backwards starts again, reading ahead decompresses what is skipped.

    The size that a gzip file states is no help: it is there modulo 2³², and at the very end.
    """

    gzipped = True

    def __init__(self, path: Path) -> None:
        self._path = path
        self.largest = path.stat().st_size * _MAX_RATIO
        self._raw: BinaryIO = path.open("rb")
        self._file = gzip.GzipFile(fileobj=self._raw)
        self._at = 0

    def read_at(self, offset: int, size: int) -> bytes:
        """See Stream."""
        if offset < self._at:
            self._rewind()
        try:
            while self._at < offset:
                skipped = len(self._file.read(min(_PIECE, offset - self._at)))
                if not skipped:
                    return b""
                self._at += skipped
            data = self._file.read(size)
        except (EOFError, zlib.error, gzip.BadGzipFile) as error:
            at = self._at
            self._rewind()
            text = f"{self._path}: the gzipped data are damaged or truncated after byte {at} of the content"
            raise LogError(f"{text}: {' '.join(str(error).split())}") from error
        except OSError as error:
            raise cannot_read(self._path, error) from error
        self._at += len(data)
        return data

    def close(self) -> None:
        """See Stream."""
        self._file.close()
        self._raw.close()

    def _rewind(self) -> None:
        # A new reader: what the old one thinks after an error is not defined.
        self._raw.seek(0)
        self._file = gzip.GzipFile(fileobj=self._raw)
        self._at = 0


def open_stream(path: Path) -> Stream:
    """The file's bytes, decompressed if need be; LogError if it cannot be opened."""
    try:
        with path.open("rb") as file:
            packed = file.read(2) == GZIP_MAGIC
        return GzipStream(path) if packed else PlainStream(path)
    except OSError as error:
        raise cannot_read(path, error) from error
