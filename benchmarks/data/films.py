"""Benchmark films: each shows one long motion of an object, with images and ground truth.

Some frames also exist without the object, so that it can vanish.
"""

import dataclasses
import functools
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from benchmarks.data.plan import Plan, stream
from benchmarks.data.scenes import SIZE, Moment, moment_of
from benchmarks.data.store import Maker, Store
from synthetic.effects import NAMES as EFFECTS
from synthetic.frames import Frame, FrameMaker, FrameOptions
from tracker.conventions import FloatArray

RATE = 10.0
"""Frame rate [Hz]."""


@dataclass(frozen=True)
class Style:
    """Contents of the films of one style."""

    effects: tuple[str, ...] = ()
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

AROUND = 20
"""Number of frames shown before an object vanishes and after it reappears, if there are as many."""

JUMP = 0.1
"""Distance between vanishing and reappearing, if the object ever gets that far [m]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class FilmFrame(Moment):
    """A moment of a film."""

    stamps: FloatArray
    """(cameras,) timestamp of each image [s]."""
    positions: FloatArray | None = None
    """(cameras, 3) position of the object at each of them [m]; None: no object."""
    rotations: FloatArray | None = None
    """(cameras, 3, 3) world_from_object at each of them."""

    @property
    def timestamp(self) -> float:
        """That of the newest image, for which the pose is given [s]."""
        return float(self.stamps.max())

    def shown(self, camera: int | None) -> tuple[FloatArray | None, FloatArray | None]:
        """Return position and rotation that a camera's image shows; None: those at `timestamp`."""
        if camera is None or self.positions is None or self.rotations is None:
            return self.position, self.rotation
        return self.positions[camera], self.rotations[camera]


def vanishing_frames(length: int) -> list[int]:
    """Return the numbers of a film's frames at which the object vanishes."""
    times = max(1, length // 150)
    return [number * length // (times + 2) for number in range(1, times + 1)]


class FilmStore:
    """The films of one object in a style of STYLES, by number; each has `length` frames."""

    def __init__(self, object_name: str, style: str, length: int, plan: Plan) -> None:
        self.length = length
        own = stream(plan.seed, "films", object_name, style)
        make = functools.partial(_maker, object_name, STYLES[style], own, length)
        name = f"films, {object_name}, {style}, {length}"
        # A film's frames are followed by the same frames without the object.
        self.store = Store(name, FilmFrame, make, (__name__,), own, plan, 2 * length)

    def numbers(self, film: int, frames: Iterable[int], *, empty: bool = False) -> list[int]:
        """Return the numbers that frames of a film have in the store."""
        return [(2 * film + empty) * self.length + frame for frame in frames]

    def prepare(self, films: Iterable[int], *, vanishing: bool = True) -> None:
        """Render all frames that the benchmarks use, with those in which the object has vanished."""
        starts = vanishing_frames(self.length) if vanishing else []
        emptied = sorted({k for start in starts for k in range(start, min(start + ABSENT, self.length))})
        numbers: list[int] = []
        for film in films:
            numbers += self.numbers(film, range(self.length))
            numbers += self.numbers(film, emptied, empty=True)
        self.store.prepare(numbers)

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
            number = first + frame.index + length * (not frame.objects)
            yield number, film_frame(frame)

    return make


def film_frame(frame: Frame) -> FilmFrame:
    """Return what a rendered frame of a film shows."""
    positions = rotations = None
    if frame.objects:
        states = [state for (state,) in frame.objects_at_stamps]
        positions, rotations = (
            np.array([getattr(one, key) for one in states]) for key in ("position", "rotation")
        )
    return FilmFrame(**vars(moment_of(frame)), stamps=frame.stamps, positions=positions, rotations=rotations)


def vanishing_film(store: FilmStore, film: int, start: int, positions: FloatArray) -> Iterator[FilmFrame]:
    """Yield the part of a film around frame `start`, where the object vanishes and comes back elsewhere.

    Timestamps do not jump. `positions` (length, 3) [m] are those of the object in the whole film.
    """
    yield from store.frames(film, range(max(0, start - AROUND), start))
    back = start + ABSENT
    stamp = 0.0
    for frame in store.frames(film, range(start, back), empty=True):
        stamp = frame.timestamp
        yield frame
    far = np.linalg.norm(positions[back:] - positions[start - 1], axis=1)
    first = back + int(np.argmax(far > JUMP) if (far > JUMP).any() else np.argmax(far))
    shift = None
    for frame in store.frames(film, range(first, min(first + AROUND, store.length))):
        shift = stamp + 1.0 / RATE - frame.timestamp if shift is None else shift
        yield dataclasses.replace(frame, stamps=frame.stamps + shift)
