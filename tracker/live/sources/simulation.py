"""The simulated platform as a source: a short film, drawn first, then played forwards and backwards."""

from __future__ import annotations

import time
from collections.abc import Iterator
from importlib.util import find_spec
from typing import TYPE_CHECKING

from tracker.calibration.rig import CameraRig
from tracker.conventions import Image
from tracker.errors import LiveError, install
from tracker.live.moment import ImageSet

if TYPE_CHECKING:
    from synthetic.frames import Frame, FrameMaker

FRAMES = 40
"""Of the film, four seconds; drawing takes some tenths of a second each."""


class Simulation:
    """A source that shows a film of the generator `synthetic`, at 10 Hz without end.

    The generator is looked for when it is needed only: the tracker does not rest on it. Faults are raised
    at once; the film is drawn by `draw`, or when the first pictures are asked for, which then come late.

    Args:
        object_name: what is seen.
        seed: of the film.
        frames: its length.

    Raises:
        LiveError: what the generator needs is not installed.
        TrackerError: it knows no such object.
    """

    def __init__(self, object_name: str, *, seed: int = 0, frames: int = FRAMES) -> None:
        self._maker = _maker(object_name, seed, frames)
        self._undrawn: Iterator[Frame] = self._maker.chunk(0)
        self._sets: list[tuple[Image | None, ...]] = []
        self._drawn = False
        self.rig: CameraRig = self._maker.rig
        self._period, self._start, self._number = 0.1, float("nan"), -1

    def draw(self, seconds: float = float("inf")) -> bool:
        """Draw what is not drawn yet of the film, for so long at most [s]; whether all of it is."""
        until = time.monotonic() + seconds
        while not self._drawn and time.monotonic() < until:
            frame = next(self._undrawn, None)
            if frame is None:
                self._drawn = True
                self._maker.close()
            else:
                self._sets.append(tuple(frame.images))
        return self._drawn

    def next(self, timeout: float) -> ImageSet | None:
        """See `ImageSource`."""
        until = time.time() + timeout
        if not self.draw(timeout):
            return None
        if self._number < 0:
            self._start = time.time()
        due = self._start + (self._number + 1) * self._period
        if due > until:
            time.sleep(max(0.0, until - time.time()))
            return None
        time.sleep(max(0.0, due - time.time()))
        self._number = int((time.time() - self._start) / self._period)
        stamp = self._start + self._number * self._period
        images = self._sets[_to_and_fro(self._number, len(self._sets))]
        return ImageSet(images, (stamp,) * len(images), age=max(0.0, time.time() - stamp))

    def close(self) -> None:
        """See `ImageSource`."""
        self._maker.close()


def _to_and_fro(number: int, length: int) -> int:
    """Place in a film of the frames 0, 1, …, length - 1, length - 2, …, 1, 0, 1 and so on."""
    if length == 1:
        return 0
    place = number % (2 * length - 2)
    return min(place, 2 * length - 2 - place)


def _maker(object_name: str, seed: int, frames: int) -> FrameMaker:
    # Its name is not its own: another package may have it.
    found = find_spec("synthetic") is not None and find_spec("synthetic.frames") is not None
    if not found or find_spec("pybullet") is None:
        raise LiveError(f"simulation: found no generator: {install('synthetic')}")
    from synthetic.frames import FrameMaker, FrameOptions

    return FrameMaker(
        FrameOptions(object_name, seed, quality="fast", sequence=True, dropped=0.0, length=frames)
    )
