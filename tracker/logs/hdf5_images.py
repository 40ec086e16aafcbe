"""Raw images in an HDF5 log, by the blocks in which they are stored."""

from __future__ import annotations

import h5py
import numpy as np

from tracker.conventions import Image
from tracker.errors import LogError
from tracker.logs.hdf5_fields import MAX_CHUNK, faults_as_log_errors
from tracker.logs.source import MAX_SIDE, MIN_SIDE

MAX_CAMERAS = 16


class StoredImages:
    """The field `images`, (n, C, H, W) uint8."""

    def __init__(self, field: h5py.Dataset, where: str) -> None:
        """LogError if the field cannot be images."""
        shape: tuple[int, ...] = field.shape or ()
        sides = len(shape) == 4 and all(MIN_SIDE <= side <= MAX_SIDE for side in shape[2:])
        if not sides or not 1 <= shape[1] <= MAX_CAMERAS or field.dtype != np.uint8:
            raise LogError(
                f"{where}: images: found {field.dtype} of shape {shape}, expected uint8 of (frames, 1 to "
                f"{MAX_CAMERAS} cameras, {MIN_SIDE} to {MAX_SIDE} rows, as many columns)"
            )
        self._field = field
        self.count, self.cameras, self.rows, self.columns = (int(side) for side in shape)
        frame_bytes = self.cameras * self.rows * self.columns
        stored = int(field.chunks[0]) if field.chunks else 1
        # Frames that are packed together are unpacked together, else each would unpack them all again.
        self._together = stored if 1 < stored <= self.count and stored * frame_bytes <= MAX_CHUNK else 1
        self._start = 0
        self._block: Image = np.empty((0, 0, 0, 0), np.uint8)

    def read(self, index: int, what: str) -> Image:
        """(C, H, W) raw pixels of a frame; LogError where they are damaged or were never written."""
        if not self._start <= index < self._start + len(self._block):
            start = index - index % self._together
            with faults_as_log_errors(f"{what}: images"):
                if self._field.chunks:
                    self._check_chunks(start)
                block: Image = self._field[start : start + self._together]
            self._block, self._start = block, start
        result: Image = self._block[index - self._start]
        return result

    def _check_chunks(self, start: int) -> None:
        """Refuse what the library passes silently: blocks that are missing, or cut off and not packed."""
        chunks = self._field.chunks
        whole = int(np.prod(chunks, dtype=np.int64))
        packed = self._field.id.get_create_plist().get_nfilters() > 0
        for corner in np.ndindex(
            *(-(-side // chunk) for side, chunk in zip(self._field.shape[1:], chunks[1:], strict=True))
        ):
            offset = (
                start - start % chunks[0],
                *(int(c) * k for c, k in zip(corner, chunks[1:], strict=True)),
            )
            # The same search as reading does; it raises where there is no block.
            skipped, stored = self._field.id.read_direct_chunk(offset)
            if (skipped or not packed) and len(stored) < whole:
                raise LogError(f"images at {offset}: found {len(stored)} bytes, expected {whole}")
