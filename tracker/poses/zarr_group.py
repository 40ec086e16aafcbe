"""Arrays as a folder that zarr reads: version 2, without compression. The same rows give the same bytes."""

from __future__ import annotations

import contextlib
import json
import math
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from tracker.conventions import Array
from tracker.files import whole_file

ROWS = 8192
"""Rows a block."""


@contextlib.contextmanager
def whole_group(path: Path, attributes: dict[str, Any]) -> Iterator[Path]:
    """A new group, which takes the name, and the place of an older one, when the `with` block ends well."""
    with whole_file(path) as temporary:
        add_group(temporary, attributes)
        yield temporary
        if path.is_dir():  # a folder cannot be renamed onto another
            os.replace(path, temporary.with_name("old"))


def add_group(path: Path, attributes: dict[str, Any]) -> None:
    """Make a group's folder."""
    path.mkdir()
    (path / ".zgroup").write_text('{"zarr_format": 2}\n')
    (path / ".zattrs").write_text(json.dumps(attributes, indent=1) + "\n")


class RowsWriter:
    """An array that grows by rows of a shape; float32, NaN where nothing is known. One block is in memory."""

    def __init__(self, folder: Path, shape: tuple[int, ...]) -> None:
        folder.mkdir()
        self._folder, self._shape, self._count = folder, shape, 0
        self._block = np.full((ROWS, *shape), np.nan, np.float32)

    def append(self, rows: Array) -> None:
        """Add rows (k, ...)."""
        while len(rows):
            at = self._count % ROWS
            some, rows = rows[: ROWS - at], rows[ROWS - at :]
            self._block[at : at + len(some)] = some.reshape(len(some), *self._shape)
            self._count += len(some)
            if at + len(some) == ROWS:
                self._write()

    def pad_to(self, count: int) -> None:
        """Add rows of NaN until there are `count`."""
        while self._count < count:
            self.append(np.full((min(ROWS, count - self._count), *self._shape), np.nan))

    def close(self) -> None:
        """Write what is left, and the head."""
        if self._count % ROWS:
            self._write()
        about: dict[str, Any] = {"zarr_format": 2, "shape": [self._count, *self._shape], "dtype": "<f4"}
        about |= {"chunks": [ROWS, *self._shape], "order": "C", "compressor": None, "filters": None}
        (self._folder / ".zarray").write_text(json.dumps({**about, "fill_value": "NaN"}, indent=1) + "\n")

    def _write(self) -> None:
        number = math.ceil(self._count / ROWS) - 1
        key = ".".join([str(number), *["0"] * len(self._shape)])
        (self._folder / key).write_bytes(self._block.astype("<f4").tobytes())
        self._block[:] = np.nan
