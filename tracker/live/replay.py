"""A recording, replayed as if it happened now."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from tracker.errors import LiveError, TrackerError
from tracker.live.shot import Shot, SourceEnded
from tracker.logs import Log, open_log
from tracker.logs.frame import LogFrame

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
        self._frames: Iterator[LogFrame] = iter(self.log)
        self._starts = frozenset(self.log.episode_starts)
        self._last: _Planned | None = None
        self._waiting: _Planned | TrackerError | None = None
        self.skipped = 0
        """Frames that were left out, since nobody fetched them in time."""

    def next(self, timeout: float) -> Shot | None:
        """See `Source`."""
        until = time.time() + timeout
        planned = self._fetched()
        if planned.due > until:
            self._waiting = planned
            time.sleep(max(0.0, until - time.time()))
            return None
        time.sleep(max(0.0, planned.due - time.time()))
        while True:
            try:
                after = self._fetched()
            except TrackerError as error:  # of the next one; this one is whole
                self._waiting = error
                return planned.shot()
            if after.due > time.time():
                self._waiting = after
                return planned.shot()
            planned, self.skipped = after._replace(fresh=after.fresh or planned.fresh), self.skipped + 1

    def close(self) -> None:
        """See `Source`."""
        self.log.close()

    def _fetched(self) -> _Planned:
        """The next frame, and when it is due."""
        waiting, self._waiting = self._waiting, None
        if isinstance(waiting, TrackerError):
            raise waiting
        if waiting is not None:
            return waiting
        try:
            frame = next(self._frames)
        except StopIteration:
            raise SourceEnded("recording: it has ended") from None
        last = self._last
        fresh = last is None or frame.index in self._starts
        if last is None:
            start, now = _taken(frame), time.time()
        elif fresh:
            start, now = _taken(frame), last.due + _PAUSE
        else:
            start, now = last.start, last.now
        self._last = _Planned(frame, start, now, self._speed, fresh)
        return self._last


class _Planned(NamedTuple):
    """A frame, and the moment of the recording that is `now`."""

    frame: LogFrame
    start: float
    now: float
    speed: float
    fresh: bool

    @property
    def due(self) -> float:
        return self._moved(_taken(self.frame))

    def _moved(self, stamp: float) -> float:
        return self.now + (stamp - self.start) / self.speed

    def shot(self) -> Shot:
        frame = self.frame
        stamps = [frame.timestamp if np.isnan(stamp) else stamp for stamp in frame.camera_timestamps.tolist()]
        return Shot(
            frame.images,
            tuple(self._moved(stamp) for stamp in stamps),
            tuple("no image in the recording" if image is None else None for image in frame.images),
            raw=frame.raw,
            age=max(0.0, time.time() - self.due),
            fresh=self.fresh,
        )


def _taken(frame: LogFrame) -> float:
    """When the last of a frame's images was taken [s]."""
    stamps = frame.camera_timestamps
    return frame.timestamp if np.isnan(stamps).all() else float(np.nanmax(stamps))
