"""Whether an HDF5 file is as long as it says; the library notices only where it is too short."""

from __future__ import annotations

import struct
from pathlib import Path

from tracker.errors import LogError
from tracker.logs.source import cannot_read

_END_OFFSET = {0: 40, 1: 44, 2: 28, 3: 28}
"""Where the file's length stands, by the version of the file's head."""


def check_stated_end(path: Path) -> None:
    """LogError if the file is shorter or longer than its head says."""
    try:
        with path.open("rb") as file:
            head = file.read(64)
        size = path.stat().st_size
    except OSError as error:
        raise cannot_read(path, error) from error
    if len(head) < 64:
        raise LogError(f"{path}: found {size} bytes, expected an HDF5 file")
    offset = _END_OFFSET.get(head[8])
    if offset is None:  # a later version than this program knows; the library decides
        return
    (stated,) = struct.unpack_from("<Q", head, offset)
    if stated != size:
        raise LogError(f"{path}: found {size} bytes, expected the {stated} that the file states")
