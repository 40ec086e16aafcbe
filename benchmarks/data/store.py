"""Rendered scenes on disk, so that only the first run renders. Results never depend on it.

A scene is one file, named by its number, in a folder named by all that its pixels depend on: object, style
and seed, the code that renders, the versions of the libraries, the renderer.
"""

from __future__ import annotations

import ast
import functools
import hashlib
import sys
import zipfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Generic, Protocol, TypeVar

import click

from benchmarks.data.scenes import SEED, SIZE, Scene, maker
from synthetic.export.workers import Factory, run_tasks
from synthetic.render.choose import choose_renderer
from tracker.files import write_whole

ROOT = Path(__file__).resolve().parents[2]

CACHE = ROOT / "build" / "scenes"
"""Where scenes are kept; not in the repository."""

SOURCES = (
    "synthetic",
    "tracker/geometry",
    "tracker/objects",
    "tracker/calibration",
    "benchmarks/data/scenes.py",
)
"""What the pixels are made by."""

LIBRARIES = ("numpy", "opencv-python-headless", "pybullet", "pyrender", "trimesh")


@functools.cache
def fingerprint(*more: str) -> str:
    """Of code, data and libraries that scenes are made by; `more` sources as SOURCES names them."""
    digest = hashlib.sha256()
    for name in (*SOURCES, *more):
        path = ROOT / name
        for file in sorted(path.rglob("*")) if path.is_dir() else [path]:
            if file.suffix == ".py":
                digest.update(file.name.encode() + _code(file.read_bytes()))
            elif file.is_file() and file.suffix in (".toml", ".json", ".npz", ".csv", ".yml"):
                digest.update(file.name.encode() + file.read_bytes())
    for library in LIBRARIES:
        digest.update(f"{library} {_version(library)}".encode())
    digest.update(choose_renderer("auto").name.encode())
    return digest.hexdigest()[:12]


def _code(source: bytes) -> bytes:
    # Without docstrings, comments and layout: words do not move pixels.
    tree = ast.parse(source)
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if isinstance(body, list):
            node.body = [  # type: ignore[attr-defined]
                item
                for item in body
                if not (isinstance(item, ast.Expr) and isinstance(item.value, ast.Constant))
            ]
    return ast.dump(tree).encode()


def _version(library: str) -> str:
    try:
        return metadata.version(library)
    except metadata.PackageNotFoundError:
        return "none"


class Packed(Protocol):
    """A scene that can be kept."""

    def packed(self) -> bytes:
        """The scene as the content of a file."""
        ...


S = TypeVar("S", bound=Packed)


@dataclass(frozen=True)
class _Factory:
    """Makes the part of a worker."""

    maker: Callable[[], Callable[[int], Packed]]
    folder: Path

    def __call__(self) -> Callable[[int], Iterator[int]]:
        """The function that renders the scene of a number into its file."""
        make = self.maker()

        def work(index: int) -> Iterator[int]:
            write_whole(_file(self.folder, index), make(index).packed())
            yield index

        return work


def _file(folder: Path, index: int) -> Path:
    return folder / f"{index:05d}.npz"


def read_packed(path: Path, unpacked: Callable[[bytes], S]) -> S | None:
    """What `unpacked` makes of a file; None where there is none that can be read."""
    try:
        return unpacked(path.read_bytes())
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None


def read_scene(path: Path) -> Scene | None:
    """The scene of a file; None where there is none that can be read."""
    return read_packed(path, Scene.unpacked)


class Store(Generic[S]):
    """Scenes of one kind, by their numbers.

    Args:
        name: of the kind, for people.
        folder: of these scenes alone.
        maker: makes what makes scenes, in the process that does so; it can be pickled.
        read: the scene of a file, None where there is none.
        workers: number of processes that render what is missing.
    """

    def __init__(
        self,
        name: str,
        folder: Path,
        maker: Callable[[], Callable[[int], S]],
        read: Callable[[Path], S | None],
        workers: int,
    ) -> None:
        self._name, self._folder, self._maker, self._read = name, folder, maker, read
        self._workers = workers

    def prepare(self, indices: Sequence[int]) -> None:
        """Render those scenes that are not there yet."""
        self._folder.mkdir(parents=True, exist_ok=True)
        todo = [index for index in indices if not _file(self._folder, index).is_file()]
        if not todo:
            return
        factory: Factory = _Factory(self._maker, self._folder)
        # A process of its own costs more than a few scenes.
        done = run_tasks(factory, todo, self._workers if len(todo) > 4 else 1)
        label = f"rendering {self._name}"
        with click.progressbar(done, length=len(todo), label=label, file=sys.stderr) as bar:
            for _ in bar:
                pass

    def scenes(self, indices: Sequence[int]) -> Iterator[S]:
        """The scenes of these numbers, in this order."""
        self.prepare(indices)
        for index in indices:
            scene = self._read(_file(self._folder, index))
            if scene is None:
                # A file broken by someone else is made again.
                _file(self._folder, index).unlink(missing_ok=True)
                self.prepare([index])
                scene = self._read(_file(self._folder, index))
            assert scene is not None
            yield scene


class SceneStore(Store[Scene]):
    """The scenes of one object and style, by their numbers.

    Args:
        object_name: name of the object.
        style: one of `benchmarks.data.scenes.STYLES`.
        workers: number of processes that render what is missing.
        folder: where scenes are kept.
    """

    def __init__(self, object_name: str, style: str, workers: int = 2, folder: Path = CACHE) -> None:
        super().__init__(
            f"{object_name}, {style}",
            folder / f"{object_name}-{style}-{SIZE}-{SEED}-{fingerprint()}",
            functools.partial(maker, object_name, style),
            read_scene,
            workers,
        )
