"""Images that the caller has."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence

from tracker.checks import check_sequence
from tracker.conventions import FloatArray, Image
from tracker.errors import LiveError
from tracker.live.moment import ImageSet, SourceEnded
from tracker.stamps import seconds


class Pushed:
    """A source that gives what is pushed into it, from any thread; the newest replaces what waits."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._waiting: ImageSet | None = None
        self._ended = False
        self.replaced = 0
        """Sets that were replaced by a newer one before they were fetched."""

    def push(
        self,
        images: Sequence[Image | None],
        timestamp: float | Sequence[float] | FloatArray | None = None,
    ) -> None:
        """Hand over a set of images; returns at once.

        Args:
            images: one (H, W, 3) uint8 BGR image for each camera, None where there is none. They are not
                copied: do not write to them afterwards.
            timestamp: when they were taken [s], one or one for each camera; by default now, as `time.time`
                tells it.

        Raises:
            LiveError: the counts differ, or a stamp is not finite.
        """
        stamp = time.time() if timestamp is None else timestamp
        check_sequence(images, "images", LiveError)
        given = seconds(stamp, "timestamp", LiveError)
        stamps = given.ravel().tolist() * (1 if given.ndim else len(images))
        taken = ImageSet(tuple(images), tuple(stamps))
        with self._changed:
            self.replaced += self._waiting is not None
            self._waiting = taken
            self._changed.notify_all()

    def finish(self) -> None:
        """No more images will come."""
        with self._changed:
            self._ended = True
            self._changed.notify_all()

    def next(self, timeout: float) -> ImageSet | None:
        """See `ImageSource`."""
        with self._changed:
            self._changed.wait_for(lambda: self._waiting is not None or self._ended, timeout)
            taken, self._waiting = self._waiting, None
            if taken is None and self._ended:
                raise SourceEnded("pushed images: no more will come")
            return taken

    def close(self) -> None:
        """See `ImageSource`."""
        self.finish()
