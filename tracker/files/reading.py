"""Files are read within bounds, and what the operating system refuses is told in one line."""

from __future__ import annotations

import errno
import os

from tracker.errors import LogError


def read_bounded(path: str | os.PathLike[str], largest: int) -> bytes:
    """The content of a file that has at most `largest` bytes; no more are read of one that has more.

    Raises:
        OSError: the file cannot be read, or is larger.
    """
    with open(path, "rb") as file:
        content = file.read(largest + 1)
    if len(content) > largest:
        raise OSError(errno.EFBIG, f"found more than {largest} bytes", os.fspath(path))
    return content


def cannot_read(path: str | os.PathLike[str], error: OSError) -> LogError:
    """What the operating system says, in one line."""
    return LogError(f"{os.fspath(path)}: cannot be read: {error.strerror or error}")
