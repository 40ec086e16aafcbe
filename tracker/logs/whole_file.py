"""Files that appear whole or not at all, with the error of this room where they cannot."""

from __future__ import annotations

import os

from tracker.errors import LogError
from tracker.files import write_whole


def write_file(path: str | os.PathLike[str], content: bytes | str) -> None:
    """Write a file under a temporary name beside its own, then rename it; text is written as UTF-8.

    Raises:
        LogError: the file cannot be written; what was there before is untouched.
    """
    try:
        write_whole(path, content)
    except (OSError, ValueError) as error:  # ValueError: a null byte in the path
        reason = error.strerror if isinstance(error, OSError) else error
        raise LogError(f"{os.fspath(path)}: cannot be written: {reason}") from error
