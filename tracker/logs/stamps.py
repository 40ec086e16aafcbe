"""Time stamps: what a stamp can be, and that stamps do not run backwards."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from tracker.conventions import FloatArray
from tracker.errors import LogError
from tracker.logs.frame import LogFrame

MAX_STAMP = 1e11
"""Largest stamp [s] that is believed: the year 5138."""

_APART = 1e-3  # s between frames without a stamp at the beginning and the end of a recording

MAX_GAP = 3600.0
"""Longest time [s] between two frames of one recording; a job of the platform lasts minutes."""


def checked_stamp(value: float, *, what: str) -> float:
    """A stamp [s] that can be one; LogError otherwise."""
    if not 0 <= value <= MAX_STAMP:
        raise LogError(f"{what}: found the stamp {value:.6g} s, expected 0 to {MAX_STAMP:g} s")
    return float(value)


class StampOrder:
    """Checks that stamps do not go backwards, nor jump by hours, from one frame to the next.

    Equal stamps are fine: a recorder that is faster than the cameras repeats observations.
    """

    def __init__(self, *, gaps: bool) -> None:
        """Args: gaps: whether time may have passed between frames as it likes."""
        self._gap = np.inf if gaps else MAX_GAP
        self._last: FloatArray | None = None
        self._index = 0

    def check(self, frame: LogFrame, *, what: str) -> None:
        """Compare with the frame before; LogError tells what is wrong, and forgets this frame."""
        stamps = np.array([frame.timestamp, *frame.camera_timestamps])
        if self._last is not None:
            steps = np.where(np.isnan(stamps), 0.0, stamps - self._last)
            worst = int(np.argmax(np.abs(np.where(steps < 0, np.inf, steps))))
            if steps[worst] < 0 or steps[worst] > self._gap:
                way = "back" if steps[worst] < 0 else "forward"
                whose = "the frame's stamp" if worst == 0 else f"the stamp of camera number {worst}"
                raise LogError(
                    f"{what}: {whose} goes {way} by {abs(steps[worst]):.6g} s since frame {self._index}, "
                    f"expected 0 to {self._gap:g} s"
                )
            stamps = np.where(np.isnan(stamps), self._last, stamps)
        # A camera without an image yet: any stamp may follow.
        self._last = stamps
        self._index = frame.index


def with_stamps(frames: Iterable[LogFrame]) -> Iterator[LogFrame]:
    """The frames, those without a stamp with one that lies between their neighbours'."""
    waiting: list[LogFrame] = []
    last: float | None = None
    for frame in frames:
        if np.isnan(frame.timestamp):
            waiting.append(frame)
            continue
        yield from _between(waiting, last, frame.timestamp)
        waiting, last = [], frame.timestamp
        yield frame
    yield from _between(waiting, last, None)


def _between(frames: Sequence[LogFrame], before: float | None, after: float | None) -> Iterator[LogFrame]:
    count = len(frames) + 1
    if before is None:
        before = count * _APART if after is None else after - count * _APART
    step = _APART if after is None else (after - before) / count
    for number, frame in enumerate(frames, start=1):
        yield dataclasses.replace(frame, timestamp=before + number * step)
