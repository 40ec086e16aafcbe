"""What changes a memory is for one caller at a time."""

from __future__ import annotations

import threading

from tracker.errors import TrackerError


class Gate:
    """A context that one thread may be in; a second one is told so, and does not wait."""

    def __init__(self) -> None:
        self._lock = threading.Lock()

    def __reduce__(self) -> tuple[type, tuple[()]]:
        # A copy of a tracker has a gate of its own.
        return type(self), ()

    def __enter__(self) -> None:
        if not self._lock.acquire(blocking=False):
            raise TrackerError(
                "update: found another call of update or reset at work on this tracker; expected one caller "
                "at a time: take a tracker for each recording (detect may be called from many threads)"
            )

    def __exit__(self, *_: object) -> None:
        self._lock.release()
