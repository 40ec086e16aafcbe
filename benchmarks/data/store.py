"""A cache of rendered scenes and frames on disk; it never affects results.

An item is one file, named after its number, in a folder named after everything that determines its pixels:
its contents, the seed, and the fingerprint of the renderer.
"""

import dataclasses
import io
import sys
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

import click
import numpy as np

from benchmarks.data.fingerprint import fingerprint
from benchmarks.data.plan import Plan
from synthetic.export.workers import run_tasks
from tracker.files import write_whole

S = TypeVar("S")

Maker = Callable[[int, Collection[int]], Iterable[tuple[int, S]]]
"""Makes some items of a chunk: takes its number and the items' numbers, yields pairs of number and item."""


def packed(item: Any) -> bytes:
    """Pack a dataclass of numbers, arrays, tuples of arrays and None into the content of an npz file."""
    arrays: dict[str, Any] = {}
    for field in dataclasses.fields(item):
        value = getattr(item, field.name)
        if isinstance(value, tuple):
            arrays |= {f"{field.name}.{k}": part for k, part in enumerate(value)}
        elif value is not None:
            arrays[field.name] = value
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    return buffer.getvalue()


def unpacked(kind: type[S], content: bytes) -> S | None:
    """Return the item that `packed` wrote; None if the content is anything else."""
    values: dict[str, Any] = {field.name: None for field in dataclasses.fields(kind)}  # type: ignore[arg-type]
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as data:
            for key in data.files:
                name, _, place = key.partition(".")
                value = data[key] if data[key].ndim else data[key].item()
                values[name] = (*(values[name] or ()), value) if place else value
        return kind(**values)
    # For a damaged file, zipfile, zlib and NumPy raise errors of many types.
    except Exception:
        return None


@dataclass(frozen=True)
class Store(Generic[S]):
    """Items of one kind, by number."""

    name: str
    """Human-readable name, with which the folder's name begins."""
    kind: type[S]
    """Dataclass of the items."""
    maker: Callable[[], Maker[S]]
    """Makes, in the process that calls it, the function that makes items; can be pickled."""
    modules: tuple[str, ...]
    """Modules that determine the pixels, see `fingerprint`."""
    seed: int
    """Seed of these items alone, see `stream`."""
    plan: Plan
    """Where they are cached, and the number of processes that render missing ones."""
    chunk: int = 1
    """Number of items that are made together."""

    @property
    def folder(self) -> Path:
        """Folder that holds only these items."""
        name = self.name.replace(", ", "-").replace(" ", "_")
        return self.plan.cache / f"{name}-{self.seed}-{fingerprint(*self.modules)}"

    def file(self, number: int) -> Path:
        """Return the file of an item."""
        return self.folder / f"{number:05d}.npz"

    def prepare(self, numbers: Iterable[int]) -> None:
        """Render the missing items."""
        prepare([(self, numbers)], self.plan.workers)

    def scenes(self, numbers: Sequence[int]) -> Iterator[S]:
        """Yield the items with these numbers, in this order."""
        self.prepare(numbers)
        for number in numbers:
            item = self._read(number)
            if item is None:
                # Something damaged the file: render it again.
                self.file(number).unlink(missing_ok=True)
                self.prepare([number])
                item = self._read(number)
            assert item is not None
            yield item

    def _read(self, number: int) -> S | None:
        try:
            return unpacked(self.kind, self.file(number).read_bytes())
        except OSError:
            return None


def prepare(requests: Iterable[tuple[Store[Any], Iterable[int]]], workers: int) -> None:
    """Render the missing items of several stores, all in the same processes."""
    tasks: list[tuple[Store[Any], int, list[int]]] = []
    for store, numbers in requests:
        chunks: dict[int, list[int]] = {}
        for number in numbers:
            if not store.file(number).is_file():
                chunks.setdefault(number // store.chunk, []).append(number)
        tasks += [(store, chunk, own) for chunk, own in chunks.items()]
    count = sum(len(numbers) for _, _, numbers in tasks)
    if not count:
        return
    # Starting processes costs more than rendering a few scenes.
    done = run_tasks(_rendering, tasks, workers if count > 4 else 1)
    with click.progressbar(done, length=count, label="rendering", file=sys.stderr) as bar:
        for _ in bar:
            pass


def _rendering() -> Callable[[tuple[Store[Any], int, list[int]]], Iterator[int]]:
    """Return the function with which a worker renders the items of a chunk into their files."""
    known: dict[Path, Maker[Any]] = {}

    def work(task: tuple[Store[Any], int, list[int]]) -> Iterator[int]:
        store, chunk, numbers = task
        if store.folder not in known:
            # Tasks come store by store, so the last store's maker is no longer needed.
            known.clear()
            store.folder.mkdir(parents=True, exist_ok=True)
            known[store.folder] = store.maker()
        for number, item in known[store.folder](chunk, numbers):
            write_whole(store.file(number), packed(item))
            yield number

    return work


def each(begin: Callable[..., Callable[[int], S]], *arguments: Any) -> Maker[S]:
    """Return a maker of items, one by one, that calls the function returned by `begin` in its own process."""
    make = begin(*arguments)
    return lambda chunk, numbers: ((number, make(number)) for number in numbers)
