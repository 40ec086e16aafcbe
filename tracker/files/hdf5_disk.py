"""A file for the HDF5 library to write to that never refuses anything.

When the disk is full the library loses track of what it has open, and ends the process at the latest when
that is closed. Here what the disk does not take is kept in memory, so that the library can finish, and the
fault is there to be told. Nothing is written to the disk after the first fault, so that it keeps what was
there at that moment.
"""

from __future__ import annotations

import io
import os
from typing import Any


class Disk(io.FileIO):
    """The file-like object that h5py writes through; what `flush` returned from outlives the process.

    Args:
        path: of a file that does not exist yet.

    Raises:
        OSError: it cannot be made.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        super().__init__(path, "xb+")
        self._at = self._end = 0
        self._kept: list[tuple[int, bytes]] = []
        self.fault: OSError | None = None
        """The first thing that the disk refused."""

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Move to an offset from the beginning, or from the end."""
        self._at = offset + (self._end if whence == os.SEEK_END else 0)
        return self._at

    def write(self, data: Any) -> int:
        """Take all of it."""
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
        """Give back what was written, from the disk or from memory."""
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
        """Make it so long; None: as far as it has been read or written."""
        size = self._at if size is None else size
        try:
            if self.fault is None:
                super().truncate(size)
        except OSError as error:
            self.fault = error
        self._end = size
        return size
