"""What reading a recording takes and gives, and files of HDF5 changed in place."""

import contextlib
import re
import tracemalloc
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import h5py
import pytest

import tracker
from tracker.errors import LogError
from tracker.logs import LogFrame

Change = Callable[[h5py.File], object]


@contextlib.contextmanager
def peak_memory() -> Iterator[list[int]]:
    """Gives a list that has the most memory [bytes] that was in use once the block has ended."""
    used: list[int] = []
    tracemalloc.start()
    yield used
    used.append(tracemalloc.get_traced_memory()[1])
    tracemalloc.stop()


def frames_of(path: Path, **options: Any) -> list[LogFrame]:
    """All frames of a recording."""
    with tracker.open_log(path, **options) as log:
        return list(log)


def recovered(path: Path, message: str) -> tuple[list[int], list[int]]:
    """Numbers of the frames before an error that matches, and of all with `recover`, which tells it, too."""
    before: list[int] = []
    with pytest.raises(LogError, match=message), tracker.open_log(path) as log:
        before.extend(frame.index for frame in log)
    with tracker.open_log(path, recover=True) as log:
        after = [frame.index for frame in log]
        assert re.search(message, log.fault)
    return before, after


def datasets(file: h5py.File) -> dict[str, h5py.Dataset]:
    """All datasets of a file, by path."""
    names: list[str] = []
    file.visit(names.append)
    return {name: file[name] for name in names if isinstance(file[name], h5py.Dataset)}


def change(path: Path, *changes: Change) -> None:
    """Make changes in a file of HDF5."""
    with h5py.File(path, "r+") as file:
        for one in changes:
            one(file)


def without(name: str) -> Change:
    return lambda file: file.__delitem__(name)


def put(name: str, array: Any) -> Change:
    """Another dataset, or a link, under a name."""

    def exchange(file: h5py.File) -> None:
        del file[name]
        file[name] = array

    return exchange


def edit(name: str, rows: Any, value: Any) -> Change:
    """Other values in some rows of a dataset."""
    return lambda file: file[name].__setitem__(rows, value)


def attribute(key: str, value: Any = None, at: str = "/") -> Change:
    """Another value of an attribute, or none."""
    return lambda file: file[at].attrs.pop(key) if value is None else file[at].attrs.__setitem__(key, value)


def made(name: str, *arguments: Any, **options: Any) -> Change:
    """A dataset made again; without `data` nothing of it is written."""

    def make(file: h5py.File) -> None:
        del file[name]
        file.create_dataset(name, *arguments, **options)

    return make


def unpacking_to(name: str, size: int = 20_000_000, *, sums: bool = False) -> Change:
    """A dataset made again of one block that unpacks to `size` bytes, with checksums or without."""

    def make(file: h5py.File) -> None:
        shape, dtype = file[name].shape, file[name].dtype
        del file[name]
        field = file.create_dataset(name, shape, dtype, chunks=shape, compression="gzip", fletcher32=sums)
        packed = zlib.compress(bytes(size), 9) + 4 * sums * b"x"
        field.id.write_direct_chunk((0,) * len(shape), packed)

    return make
