"""What is looked at to mend a calibration: recordings, and pictures that were taken one set at a time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple, Protocol

from tracker.conventions import FloatArray, Image
from tracker.logs import Log

Images = Sequence[Image | None]
"""(H, W, 3) BGR of each camera of a rig, None where it gave none."""


class Shot(NamedTuple):
    """What the cameras gave at one moment."""

    number: int
    images: Images
    stamps: FloatArray | None
    """(C,) when the pictures were taken [s]; None: at a moment of their own."""
    begins: bool
    """Whether what was before does not matter."""


class Footage(Protocol):
    """A film, or stills."""

    def shots(self) -> Iterator[Shot]:
        """All of it, in order."""

    def images(self, numbers: Sequence[int]) -> Iterator[Images]:
        """The pictures of some shots, by number, which ascend."""


class Film:
    """A recording.

    Args:
        log: open as long as this is used.
        stills: each of its frames was taken at a moment of its own.
    """

    def __init__(self, log: Log, *, stills: bool = False) -> None:
        self._log, self._stills = log, stills or len(log) == 1

    def shots(self) -> Iterator[Shot]:
        """See Footage."""
        starts = frozenset(self._log.episode_starts)
        alone = {index for index in starts if index + 1 in starts or index + 1 == len(self._log)}
        for frame in self._log:
            still = self._stills or frame.index in alone
            stamps = None if still else frame.camera_timestamps
            yield Shot(frame.index, frame.images, stamps, still or frame.index in starts)

    def images(self, numbers: Sequence[int]) -> Iterator[Images]:
        """See Footage."""
        if self._log.random_access:
            yield from (self._log.frame(number).images for number in numbers)
        else:
            wanted = set(numbers)
            yield from (frame.images for frame in self._log if frame.index in wanted)


class Stills:
    """Sets of pictures, each taken at a moment of its own."""

    def __init__(self, sets: Sequence[Images]) -> None:
        self._sets = sets

    def shots(self) -> Iterator[Shot]:
        """See Footage."""
        return (Shot(k, images, None, True) for k, images in enumerate(self._sets))

    def images(self, numbers: Sequence[int]) -> Iterator[Images]:
        """See Footage."""
        return (self._sets[number] for number in numbers)
