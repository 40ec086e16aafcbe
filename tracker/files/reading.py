"""Files are read within bounds, and what the operating system refuses is told in one line."""

from __future__ import annotations

import contextlib
import errno
import os
import stat
from collections.abc import Iterator
from io import BufferedReader

from tracker.errors import LogError


def open_regular(path: str | os.PathLike[str]) -> BufferedReader:
    """A regular file, open for reading; nothing is waited for, as a pipe without a writer would.

    Raises:
        OSError: the file cannot be opened, or is a folder, a pipe or a device.
    """
    handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        kind = os.fstat(handle).st_mode
        if stat.S_ISDIR(kind):
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), os.fspath(path))
        if not stat.S_ISREG(kind):
            raise OSError(errno.EINVAL, "found a pipe or a device, expected a regular file", os.fspath(path))
        return os.fdopen(handle, "rb")
    except BaseException:
        os.close(handle)
        raise


def read_bounded(path: str | os.PathLike[str], largest: int) -> bytes:
    """The content of a regular file of at most `largest` bytes; no more are read of one that has more.

    Raises:
        OSError: the file cannot be read, is no regular file, or is larger.
    """
    with open_regular(path) as file:
        content = file.read(largest + 1)
    if len(content) > largest:
        raise OSError(errno.EFBIG, f"found more than {largest} bytes", os.fspath(path))
    return content


@contextlib.contextmanager
def told_of(path: str | os.PathLike[str]) -> Iterator[None]:
    """What the operating system refuses while a recording is read is raised as LogError."""
    try:
        yield
    except OSError as error:
        raise cannot_read(path, error) from error


def cannot_read(path: str | os.PathLike[str], error: OSError) -> LogError:
    """What the operating system says, in one line."""
    return LogError(f"{os.fspath(path)}: cannot be read: {error.strerror or error}")
