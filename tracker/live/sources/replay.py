"""A recording, replayed as if it happened now."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from tracker.errors import LiveError, TrackerError
from tracker.live.moment import ImageSet, SourceEnded
from tracker.logs import Log, open_log

_PAUSE = 0.1
"""Between the last frame of an episode and the first of the next, whose stamps tell nothing of it [s]."""


class Replay:
    """A source that gives a recording's frames at the pace of their stamps.

    Stamps are moved to begin when the first frame is asked for, on the clock of `time.time`. A frame that
    nobody fetches before the next is due is left out, as a camera's would be.

    Args:
        log: the recording, or its path.
        speed: how many times as fast as it was recorded.

    Raises:
        TrackerError: the recording cannot be opened, or the speed is not above zero.
    """

    def __init__(self, log: Log | str | os.PathLike[str], *, speed: float = 1.0) -> None:
        if not (np.isfinite(speed) and speed > 0):
            raise LiveError(f"replay: speed: found {speed:g}, expected above 0")
        self.log = log if isinstance(log, Log) else open_log(log)
        self._speed = speed
        self._plan = self._planned()
        self._ahead: tuple[float, ImageSet] | TrackerError | None = None
        self.skipped = 0
        """Frames that were left out, since nobody fetched them in time."""

    def next(self, timeout: float) -> ImageSet | None:
        """See `ImageSource`."""
        until = time.time() + timeout
        due, found = self._coming()
        time.sleep(max(0.0, min(due, until) - time.time()))
        if due > until:
            return None
        fresh, self._ahead = found.fresh, None
        with contextlib.suppress(TrackerError):  # of the next frame; this one is whole
            while self._coming()[0] <= time.time():
                due, found = self._coming()
                fresh, self._ahead, self.skipped = fresh or found.fresh, None, self.skipped + 1
        return replace(found, age=max(0.0, time.time() - due), fresh=fresh)

    def close(self) -> None:
        """See `ImageSource`."""
        self.log.close()

    def _coming(self) -> tuple[float, ImageSet]:
        """The next set, and when it is due [s]; the same until `_ahead` is emptied."""
        if self._ahead is None:
            self._ahead = next(self._plan)
        if isinstance(self._ahead, TrackerError):
            raise self._ahead
        return self._ahead

    def _planned(self) -> Iterator[tuple[float, ImageSet] | TrackerError]:
        """When each set is due, with its stamps moved; then why there are no more."""
        starts, due = frozenset(self.log.episode_starts), None
        begin = now = 0.0  # the stamp at which this episode begins, and the moment that it is moved to
        try:
            for frame in self.log:
                given = frame.camera_timestamps
                last = frame.timestamp if np.isnan(given).all() else float(np.nanmax(given))
                stamps = np.where(np.isnan(given), frame.timestamp, given)
                fresh = due is None or frame.index in starts
                if fresh:
                    begin, now = last, time.time() if due is None else due + _PAUSE
                due = now + (last - begin) / self._speed
                moved = now + (stamps - begin) / self._speed
                faults = tuple("no image in the recording" if one is None else None for one in frame.images)
                yield due, ImageSet(frame.images, tuple(moved.tolist()), faults, raw=frame.raw, fresh=fresh)
        except TrackerError as error:
            yield error
        yield SourceEnded("recording: it has ended")
