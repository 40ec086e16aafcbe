"""Files, of which nothing is believed: read within bounds, and written whole or not at all."""

from tracker.files.reading import cannot_read, open_regular, read_bounded, told_of
from tracker.files.writing import claimed, lock_of, told_as, whole_file, write_whole

__all__ = [
    "cannot_read",
    "claimed",
    "lock_of",
    "open_regular",
    "read_bounded",
    "told_as",
    "told_of",
    "whole_file",
    "write_whole",
]
