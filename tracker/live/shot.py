"""One set of images, and what every source of them does."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from tracker.conventions import Image
from tracker.errors import LiveError


class SourceEnded(LiveError):
    """There are no more images, as was to be expected: a recording's end."""


@dataclass(frozen=True, eq=False)
class Shot:
    """What the cameras gave at one moment.

    Raises:
        LiveError: the counts differ, or a stamp is not finite.
    """

    images: tuple[Image | None, ...]
    """(H, W, 3) uint8 BGR of each camera in order, or None where it gave none."""
    stamps: tuple[float, ...]
    """When each image was taken [s]; where there is none, the moment at which it was missed."""
    faults: tuple[str | None, ...] = ()
    """What is wrong with each camera, in few words; None: nothing."""
    raw: tuple[Image | None, ...] | None = None
    """(H, W) raw Bayer pixels of each camera, red at even rows and columns; None where it gives colours."""
    age: float = 0.0
    """How long ago the latest image was taken when the set was handed over [s]."""
    fresh: bool = False
    """Whether something new begins, so that memory of what was before misleads."""

    def __post_init__(self) -> None:
        count = len(self.images)
        if not self.faults:
            object.__setattr__(self, "faults", (None,) * count)
        if not (count == len(self.stamps) == len(self.faults) and count):
            raise LiveError(f"shot: found {count} images and {len(self.stamps)} stamps, expected as many")
        if not np.isfinite(self.stamps).all():
            raise LiveError(f"shot: found the stamps {list(self.stamps)}, expected finite numbers of seconds")

    @property
    def timestamp(self) -> float:
        """Stamp of the latest image; without any, the latest stamp [s]."""
        there = [t for image, t in zip(self.images, self.stamps, strict=True) if image is not None]
        return max(there or self.stamps)


class Source(Protocol):
    """Gives sets of images; only the newest counts, those that were not fetched in time are left out."""

    def next(self, timeout: float) -> Shot | None:
        """The newest set that has not been given yet, waited for up to `timeout` [s]; None: none came.

        Raises:
            SourceEnded: none will come.
            TrackerError: the source cannot go on.
        """

    def close(self) -> None:
        """Free the cameras or files; called once, when nobody is in `next`."""
