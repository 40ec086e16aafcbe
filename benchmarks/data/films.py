"""Benchmark films: each shows one long motion of an object, with images and ground truth.

Some frames also exist without the object, so that it can vanish.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.data.scenes import SIZE, cameras_of
from benchmarks.data.seeds import stream
from benchmarks.data.store import CACHE, Maker, Store
from synthetic.effects import NAMES as EFFECTS
from synthetic.frames import Frame, FrameMaker, FrameOptions
from tracker.conventions import FloatArray, Image

RATE = 10.0
"""Frame rate [Hz]."""


@dataclass(frozen=True)
class Style:
    """Contents of the films of one style."""

    effects: tuple[str, ...] = ()
    """Real-world effects."""
    kinds: tuple[str, ...] = ("mixed",)
    """Kinds of motion in consecutive films; mixed: pushed, tumbled, lifted, carried, dropped."""
    quality: str = "default"
    """Key of `synthetic.camera.shot.QUALITIES`."""


STYLES = {
    "realistic": Style(),
    "world": Style(EFFECTS),
    "errors": Style(EFFECTS, ("push", "tumble", "carry", "drop"), "fast"),
}
"""Styles by name. There are many films of `errors`, so they are rendered without the lamps' shadows."""

ABSENT = 20
"""Number of frames for which a vanishing object is absent."""

JUMP = 0.1
"""Distance between vanishing and reappearing, if the object ever gets that far [m]."""


@dataclass(frozen=True, eq=False)
class FilmFrame:
    """One image of each camera, and the ground truth."""

    timestamp: float
    """[s]"""
    images: tuple[Image, ...]
    """(H, W, 3) uint8 BGR."""
    visible_fraction: FloatArray
    """(cameras,) visible share of the object's pixels."""
    position: FloatArray | None
    """(3,) position of the object [m]; None: no object."""
    rotation: FloatArray | None
    """(3, 3) world_from_object."""
    cameras: FloatArray | None = None
    """As in `benchmarks.data.scenes.Scene`."""


def vanishing_frames(length: int) -> list[int]:
    """Return the numbers of a film's frames at which the object vanishes."""
    times = max(1, length // 150)
    return [number * length // (times + 2) for number in range(1, times + 1)]


class FilmStore:
    """The films of one object, by number.

    Args:
        object_name: name of the object.
        style: key of STYLES.
        length: number of frames of each film.
        seed: seed of the benchmark.
        workers: number of processes that render, one film each.
        cache: folder of rendered frames.
    """

    def __init__(
        self, object_name: str, style: str, length: int, seed: int, workers: int = 2, cache: Path = CACHE
    ) -> None:
        self.length = length
        own = stream(seed, "films", object_name, style)
        make = functools.partial(_maker, object_name, STYLES[style], own, length)
        name = f"films, {object_name}, {style}, {length}"
        # A film's frames are followed by the same frames without the object.
        self.store = Store(name, FilmFrame, make, (__name__,), own, 2 * length, workers, cache)

    def numbers(self, film: int, frames: Iterable[int], *, empty: bool = False) -> list[int]:
        """Return the numbers that frames of a film have in the store."""
        return [(2 * film + empty) * self.length + frame for frame in frames]

    def prepared(self, films: Iterable[int], *, vanishing: bool = True) -> list[int]:
        """Return the numbers that all frames used by the benchmarks have in the store."""
        starts = vanishing_frames(self.length) if vanishing else []
        emptied = sorted({k for start in starts for k in range(start, min(start + ABSENT, self.length))})
        return [
            number
            for film in films
            for number in (
                *self.numbers(film, range(self.length)),
                *self.numbers(film, emptied, empty=True),
            )
        ]

    def frames(self, film: int, frames: Iterable[int], *, empty: bool = False) -> Iterator[FilmFrame]:
        """Yield frames of a film, in the given order."""
        return self.store.scenes(self.numbers(film, frames, empty=empty))


def _maker(object_name: str, style: Style, seed: int, length: int) -> Maker[FilmFrame]:
    @functools.cache
    def maker(kind: str) -> FrameMaker:
        options = FrameOptions(
            object_name,
            seed,
            style.quality,
            sequence=True,
            size=SIZE,
            rate=RATE,
            kind=kind,
            dropped=0.0,
            length=length,
            effects=style.effects,
        )
        return FrameMaker(options)

    def make(film: int, numbers: Collection[int]) -> Iterator[tuple[int, FilmFrame]]:
        first = film * length
        places = [divmod(number - 2 * film * length, length) for number in numbers]
        whole, emptied = ({first + frame for empty, frame in places if empty == part} for part in (0, 1))
        for frame in maker(style.kinds[film % len(style.kinds)]).chunk(film, whole, emptied):
            yield frame.index + first + length * (not frame.objects), _film_frame(frame)

    return make


def _film_frame(frame: Frame) -> FilmFrame:
    pose = frame.objects[0] if frame.objects else None
    return FilmFrame(
        frame.timestamp,
        frame.images,
        frame.visible_fraction,
        None if pose is None else np.array(pose.position),
        None if pose is None else np.array(pose.rotation),
        cameras_of(frame),
    )


def vanishing_film(
    store: FilmStore, film: int, start: int, positions: FloatArray, around: int = 20
) -> Iterator[FilmFrame]:
    """Yield a film in which the object vanishes at frame `start` and comes back elsewhere.

    Timestamps do not jump.

    Args:
        store: store of the film.
        film: number of the film.
        start: first frame without the object.
        positions: (length, 3) positions of the object in the whole film [m].
        around: number of frames before and after, if there are as many.
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
