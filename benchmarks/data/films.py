"""Films that are judged: one long motion of an object each, the pictures and what is true of them.

A frame is one file, named by its number, in a folder named by all that its pixels depend on. Some frames
exist a second time without the object, so that it can vanish.
"""

from __future__ import annotations

import dataclasses
import io
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import click
import numpy as np

from benchmarks.data import scenes
from benchmarks.data.scenes import OBJECTS, SIZE
from benchmarks.data.store import CACHE, fingerprint, read_packed
from synthetic.export.workers import Factory, run_tasks
from synthetic.frames import Frame, FrameMaker, FrameOptions
from tracker.conventions import FloatArray, Image
from tracker.files import write_whole

SEED = scenes.SEED + 10 * len(OBJECTS) + 10
"""Of the first object's films, the next one's is one more. Like the seed it comes from, for nothing else."""

RATE = 10.0
"""Frames per second [Hz]."""

KIND = "mixed"
"""Of motion: pushed, tumbled, lifted, carried, dropped."""

ABSENT = 20
"""Frames for which an object that vanishes is away."""

JUMP = 0.1
"""Distance from where it vanished, at which an object appears again if it ever is so far [m]."""


@dataclass(frozen=True, eq=False)
class FilmFrame:
    """One picture of each camera, and the truth."""

    timestamp: float
    """[s]"""
    images: tuple[Image, ...]
    """(H, W, 3) uint8 BGR."""
    visible_fraction: FloatArray
    """(cameras,) visible share of the object's pixels."""
    position: FloatArray | None
    """(3,) of the object [m]; None: there is none."""
    rotation: FloatArray | None
    """(3, 3) world from object."""

    def packed(self) -> bytes:
        """The frame as the content of an npz file."""
        pose = np.empty((0, 4)) if self.position is None else np.c_[self.rotation, np.asarray(self.position)]
        buffer = io.BytesIO()
        np.savez_compressed(
            buffer,
            timestamp=self.timestamp,
            images=np.stack(self.images),
            visible_fraction=self.visible_fraction,
            pose=pose,
        )
        return buffer.getvalue()

    @classmethod
    def unpacked(cls, content: bytes) -> FilmFrame:
        """The frame that `packed` wrote.

        Raises:
            ValueError, KeyError, OSError, zipfile.BadZipFile: the content is something else.
        """
        with np.load(io.BytesIO(content), allow_pickle=False) as data:
            pose = data["pose"]
            return cls(
                float(data["timestamp"]),
                tuple(data["images"]),
                data["visible_fraction"],
                pose[:, 3].copy() if len(pose) else None,
                pose[:, :3].copy() if len(pose) else None,
            )


def vanishing_frames(length: int) -> list[int]:
    """Numbers of the frames of a film in which the object begins to be absent, one for each time."""
    times = max(1, length // 150)
    return [number * length // (times + 2) for number in range(1, times + 1)]


@dataclass(frozen=True)
class FilmStore:
    """The films of one object, by their numbers."""

    object_name: str
    length: int
    """Frames of each."""
    seed: int = SEED
    """Of the first object; another one than SEED for all but judging."""
    workers: int = 2
    """Processes that render, a film each."""
    cache: Path = CACHE
    """Where rendered frames are kept."""

    @property
    def folder(self) -> Path:
        """Of this object's films alone."""
        print_ = fingerprint("benchmarks/data/films.py")
        own = f"{SIZE}-{self._own_seed}-{self.length}-{print_}"
        return self.cache / f"film-{self.object_name}-{own}"

    @property
    def _own_seed(self) -> int:
        return self.seed + OBJECTS.index(self.object_name)

    def file(self, film: int, number: int, empty: bool = False) -> Path:
        """Of a frame of a film, with or without the object."""
        return self.folder / f"{film:02d}" / f"{number:05d}{'-empty' * empty}.npz"

    def prepare(self, films: Sequence[int]) -> None:
        """Render those frames that cannot be read."""
        todo = [film for film in films if any(self._missing(film))]
        if not todo:
            return
        count = sum(len(part) for film in todo for part in self._missing(film))
        factory: Factory = _Factory(self)
        done = run_tasks(factory, todo, self.workers)
        label = f"rendering films, {self.object_name}"
        with click.progressbar(done, length=count, label=label, file=sys.stderr) as bar:
            for _ in bar:
                pass

    def _missing(self, film: int) -> tuple[list[int], list[int]]:
        """Numbers of the frames that are not there, with and without the object."""
        starts = vanishing_frames(self.length)
        emptied = sorted({k for start in starts for k in range(start, min(start + ABSENT, self.length))})
        return (
            [k for k in range(self.length) if not self.file(film, k).is_file()],
            [k for k in emptied if not self.file(film, k, empty=True).is_file()],
        )

    def render(self, maker: FrameMaker, film: int) -> Iterator[int]:
        """Render what is missing of a film; yields the numbers of the frames."""
        first = film * self.length
        whole, emptied = ({first + k for k in part} for part in self._missing(film))
        for frame in maker.chunk(film, whole, emptied):
            number = frame.index - first
            file = self.file(film, number, empty=not frame.objects)
            file.parent.mkdir(parents=True, exist_ok=True)
            write_whole(file, _film_frame(frame).packed())
            yield number

    def maker(self) -> FrameMaker:
        """What renders the frames."""
        return FrameMaker(
            FrameOptions(
                self.object_name,
                self._own_seed,
                sequence=True,
                size=SIZE,
                rate=RATE,
                kind=KIND,
                dropped=0.0,
                length=self.length,
            )
        )

    def frames(self, film: int, numbers: Sequence[int], empty: bool = False) -> Iterator[FilmFrame]:
        """Frames of a film, in this order."""
        self.prepare([film])
        for number in numbers:
            frame = read_packed(self.file(film, number, empty), FilmFrame.unpacked)
            if frame is None:
                # A file broken by someone else is made again.
                self.file(film, number, empty).unlink(missing_ok=True)
                self.prepare([film])
                frame = read_packed(self.file(film, number, empty), FilmFrame.unpacked)
            assert frame is not None
            yield frame


@dataclass(frozen=True)
class _Factory:
    """Makes the part of a worker."""

    store: FilmStore

    def __call__(self) -> Callable[[int], Iterator[int]]:
        """The function that renders a film into its files."""
        maker = self.store.maker()
        return lambda film: self.store.render(maker, film)


def _film_frame(frame: Frame) -> FilmFrame:
    pose = frame.objects[0] if frame.objects else None
    return FilmFrame(
        frame.timestamp,
        frame.images,
        frame.visible_fraction,
        None if pose is None else np.array(pose.position),
        None if pose is None else np.array(pose.rotation),
    )


def vanishing_film(
    store: FilmStore, film: int, start: int, positions: FloatArray, around: int = 20
) -> Iterator[FilmFrame]:
    """A film in which the object vanishes at frame `start` and comes back elsewhere.

    The time stamps do not jump.

    Args:
        store: of the film.
        film: its number.
        start: first frame without the object.
        positions: (length, 3) of the object in the whole film [m].
        around: frames before and after, as many as there are.
    """
    yield from store.frames(film, range(max(0, start - around), start))
    back = start + ABSENT
    stamp = 0.0
    for frame in store.frames(film, range(start, back), empty=True):
        stamp = frame.timestamp
        yield frame
    far = np.linalg.norm(positions[back:] - positions[start - 1], axis=1)
    first = back + int(np.argmax(far > JUMP) if (far > JUMP).any() else np.argmax(far))
    shift = None
    for frame in store.frames(film, range(first, min(first + around, store.length))):
        shift = stamp + 1.0 / RATE - frame.timestamp if shift is None else shift
        yield dataclasses.replace(frame, timestamp=frame.timestamp + shift)
