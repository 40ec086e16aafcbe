"""Run a tracker in a thread of its own; its newest result is available at any time."""

from __future__ import annotations

import atexit
import os
import re
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace

import numpy as np

from tracker.checks import check_sequence, is_number, is_whole, one_stamp, shown_in
from tracker.conventions import Image
from tracker.errors import LiveError, message, shown
from tracker.geometry.camera import Camera
from tracker.live.moment import ImageSet, ImageSource, Moment, SourceEnded, camera_faults
from tracker.live.sources import FORMS, open_source
from tracker.pipeline import ObjectTracker
from tracker.pose.result import MotionEstimate

HISTORY = 256
"""Number of moments whose poses are kept: 25 s at 10 Hz."""

STAMPS_APART = 1.0
"""Largest difference of a camera's timestamp from the others' [s]; beyond it the image is dropped."""

FAULTS = 100
"""Number of faults kept."""

CLOSING = 5.0
"""How long `close` waits for a source that does not return [s]."""

PATIENCE = 0.1
"""How long a thread waits before it checks whether to end [s]."""


def check_arguments(tracker: object, history: object, listeners: Sequence[object] = ()) -> None:
    """Raise LiveError if one of the arguments of Live with these names is invalid."""
    if not (callable(getattr(tracker, "update", None)) and hasattr(tracker, "rig")):
        raise LiveError(f"tracker: found {shown(tracker)}, expected a tracker.ObjectTracker")
    if not is_whole(history) or not 1 <= history <= 10**9:
        raise LiveError(f"history: found {shown(history)}, expected a whole number from 1 to {10**9:,}")
    check_sequence(listeners, "listeners", LiveError, "a sequence of functions")
    for listener in listeners:
        if not callable(listener):
            raise LiveError(f"listeners: found {shown(listener)}, expected functions of a Moment")


class Live(AbstractContextManager["Live"]):
    """Tracks an object in the images of a source, from its creation until `close`; a context manager.

    The tracker runs in a thread of its own, which owns it: do not call its `update` or `reset`. If several
    sets of images arrive while one is processed, the newest is processed next. Only `wait` and `close` wait
    for the tracker.

    Args:
        source: the source of images, which is closed at the end; or an argument of `open_source`: a
            recording's path, `pylon`, `opencv:0,1,2`, `simulation`.
        tracker: the tracker that finds the object.
        listeners: called in the tracking thread with each Moment; must return quickly. A listener that raises
            is not called again, and is reported in `faults`.
        history: number of moments kept for `at`.

    Raises:
        TrackerError: the source cannot be opened, or an argument has the wrong type or value.
    """

    def __init__(
        self,
        source: ImageSource | str | os.PathLike[str],
        tracker: ObjectTracker,
        *,
        listeners: Sequence[Callable[[Moment], None]] = (),
        history: int = HISTORY,
    ) -> None:
        check_arguments(tracker, history, listeners)
        if isinstance(source, (str, os.PathLike)):
            source = open_source(source, tracker)
        if not callable(getattr(source, "next", None)):
            raise LiveError(
                f"source: found {type(source).__name__}, expected one as those of tracker.live, Replay of "
                f"a recording among them, or {FORMS}"
            )
        self._source, self._tracker, self._listeners = source, tracker, list(listeners)
        self._changed = threading.Condition()
        self._newest: Moment | None = None
        self._forecasts: deque[tuple[float, Callable[[float], MotionEstimate | None]]] = deque(maxlen=history)
        self._faults: dict[str, str] = {}  # the last of each kind
        self._error: BaseException | None = None
        self._stopping, self._running, self._working = threading.Event(), True, False
        self._count, self._jump_count = 0, 0
        self._fault_counts = dict.fromkeys(tracker.rig.names, 0)
        self._last: float | None = None  # timestamp of the last set [s], which came at `_begun`
        self._begun = 0.0
        self._thread = threading.Thread(target=self._run, name="tracker.live", daemon=True)
        # Python would end the thread within a library at exit, which may hang or abort.
        atexit.register(self.close)
        self._thread.start()

    def __exit__(self, kind: object, *_: object) -> None:
        self.close()
        if kind is None and self._error is not None and not isinstance(self._error, Exception):
            raise self._error

    @property
    def running(self) -> bool:
        """Whether more moments may come: not closed, the source has not ended, and nothing has failed."""
        return self._running and self._thread.is_alive()  # it is not in a fork

    @property
    def _lock(self) -> threading.Condition | nullcontext[None]:
        """Guards the thread's results; without the thread, as in a fork, a lock might never be freed."""
        return self._changed if self._thread.is_alive() else nullcontext()

    @property
    def error(self) -> BaseException | None:
        """The exception that ended the source or the tracker; None if there was none.

        A KeyboardInterrupt or SystemExit in the source is re-raised by `wait`, and at the end of a
        with-statement unless that ends with another exception.
        """
        return self._error

    @property
    def faults(self) -> tuple[str, ...]:
        """The last hundred faults after which tracking continued, distinct apart from their times."""
        with self._lock:
            return tuple(self._faults.values())

    def latest(self) -> Moment | None:
        """Return the newest moment, None before the first; its age follows from its timestamp."""
        return self._newest

    def wait(self, after: Moment | int | None = None, timeout: float | None = None) -> Moment | None:
        """Wait for a moment newer than another, and return the newest.

        Args:
            after: the other moment, or its sequence number; None: the newest one at the call.
            timeout: how long to wait [s]; None: without limit.

        Returns:
            None if no moment came in time, or none will come since the source has ended or this was closed.

        Raises:
            LiveError: the source or the tracker failed, as the message says, or an argument is invalid.
            KeyboardInterrupt, SystemExit: the source raised it.
        """
        number = after.sequence if isinstance(after, Moment) else after
        if number is not None and not is_whole(number):
            raise LiveError(f"after: found {shown(after)}, expected a Moment, its sequence number, or None")
        if timeout is not None and not is_number(timeout):
            raise LiveError(f"timeout: found {shown(timeout)}, expected seconds, or None")
        with self._lock:
            seen = self._count if number is None else max(0, int(number) + 1)
            longest = None if timeout is None else min(float(timeout), threading.TIMEOUT_MAX)
            if self.running:
                self._changed.wait_for(lambda: self._count > seen or not self._running, longest)
            if self._count > seen:
                return self.latest()
            if isinstance(self._error, Exception):
                raise LiveError(f"live: {message(self._error)}") from self._error
            if self._error is not None:
                raise self._error
            return None

    def at(self, timestamp: float) -> MotionEstimate | None:
        """Return the pose at a time on the clock of the source's timestamps [s].

        It is predicted from the last images taken before that time. For a future time this is the expected
        pose: images are late, so a control loop that acts at `timestamp` asks for the pose at that time.

        Returns:
            None if the object was lost then, was last seen too long before, or no moment that old is kept.

        Raises:
            LiveError: the timestamp is not in seconds.
        """
        timestamp = one_stamp(timestamp, "timestamp", LiveError)
        with self._lock:
            forecast = next((one for t, one in reversed(self._forecasts) if t <= timestamp), None)
        return None if forecast is None else forecast(timestamp)

    def close(self) -> None:
        """Stop tracking and close the source; further calls do nothing.

        A source that takes seconds to return from `next` or `close` is left to the thread, which closes it
        later; `faults` reports this.
        """
        self._stopping.set()
        if self._thread is threading.current_thread():
            return
        until = time.monotonic() + CLOSING
        while self.running and (self._working or time.monotonic() < until):
            self._thread.join(PATIENCE)
        if self.running:
            self._note(f"the source does not return: not closed after {CLOSING:g} s")
            self._end()

    def _run(self) -> None:
        try:
            while not self._stopping.is_set():
                taken = self._source.next(PATIENCE)
                if taken is not None and not self._stopping.is_set():
                    self._working = True
                    moment = self._take_in(taken)
                    self._working = False  # `close` waits for a listener no longer than for a source
                    if moment is not None:
                        self._tell(moment)
        except SourceEnded:
            pass
        except BaseException as error:  # otherwise it would be lost with this thread
            self._error = error
        finally:
            self._working = False
            try:
                self._source.close()
            except Exception as error:
                self._note(f"the source could not be closed: {message(error)}")
            self._end()

    def _end(self) -> None:
        atexit.unregister(self.close)
        with self._changed:
            self._running = False
            self._changed.notify_all()

    def _take_in(self, taken: ImageSet) -> Moment | None:
        start = time.perf_counter()
        taken = self._checked(taken)
        if taken.timestamp == self._last and not taken.fresh:
            return None  # the same set again
        jump = self._jump(taken, start)
        restarts = taken.fresh or self._last is None or taken.timestamp < self._last
        if restarts:
            self._tracker.reset()
        observation = self._tracker.update(taken.images, taken.stamps)
        self._last, self._begun = taken.timestamp, start
        faults = camera_faults(self._tracker.rig.names, taken, observation.cameras)
        if jump is not None:
            self._note(f"stamps {jump}")
        self._jump_count += jump is not None
        self._fault_counts = {name: n + (name in faults) for name, n in self._fault_counts.items()}
        latency = taken.age + time.perf_counter() - start
        moment = Moment(
            self._count, taken.timestamp, observation, taken, latency,
            faults, jump, self._fault_counts, self._jump_count,
        )  # fmt: skip
        with self._changed:
            if restarts:
                self._forecasts.clear()
            self._forecasts.append((moment.timestamp, self._tracker.forecast()))
            self._newest = moment
            self._count += 1
            self._changed.notify_all()
        return moment

    def _tell(self, moment: Moment) -> None:
        for listener in tuple(self._listeners):
            try:
                listener(moment)
            except Exception as error:
                self._listeners.remove(listener)
                self._note(f"a listener is not called any more: {message(error)}")

    def _jump(self, taken: ImageSet, now: float) -> str | None:
        """Return how timestamps jumped since the last set, which came at `_begun`; None if they did not."""
        if self._last is None or taken.fresh:
            return None
        step, passed = taken.timestamp - self._last, now - self._begun
        if step < 0:
            return f"went back by {-step:.3f} s: what was before is forgotten"
        if step - passed > STAMPS_APART:
            return f"went on by {step:.3f} s within {passed:.3f} s"
        return None

    def _checked(self, taken: ImageSet) -> ImageSet:
        """Return the set without unusable images, so that the others can still be used."""
        rig = self._tracker.rig
        if len(taken.images) != len(rig):
            names = ", ".join(rig.names)
            raise LiveError(f"source: found {len(taken.images)} images, expected one for each of {names}")
        wrong = [_misfit(image, camera) for image, camera in zip(taken.images, rig, strict=True)]
        fitting = [image if fault is None else None for image, fault in zip(taken.images, wrong, strict=True)]
        middle = self._usual_stamp(fitting, taken.stamps)
        images, stamps, faults = list(taken.images), list(taken.stamps), list(taken.faults)
        raw = None if taken.raw is None else list(taken.raw)
        for c, fault in enumerate(wrong):
            if fitting[c] is not None and abs(stamps[c] - middle) > STAMPS_APART:
                fault = f"its stamp is {stamps[c] - middle:+.3f} s from the others'"
            if fault is not None:
                self._note(f"{rig.names[c]}: {fault}")
                images[c], stamps[c], faults[c] = None, middle, fault
                if raw is not None:
                    raw[c] = None  # an image of another size would end a recording
        raws = None if raw is None else tuple(raw)
        return replace(taken, images=tuple(images), stamps=tuple(stamps), faults=tuple(faults), raw=raws)

    def _usual_stamp(self, images: Sequence[Image | None], stamps: Sequence[float]) -> float:
        """Return the median timestamp of the images, the later if there is an even number.

        If there are only two, return the one closer to the last set's. Black images count as in `update`.
        """
        given = [t for t, shown in zip(stamps, shown_in(images), strict=True) if shown]
        if len(given) == 2 and (last := self._last) is not None:
            return min(given, key=lambda stamp: abs(stamp - last))
        ordered = sorted(given or stamps)
        return ordered[len(ordered) // 2]

    def _note(self, fault: str) -> None:
        with self._changed:
            kind = re.sub(r"\d+\.\d{3} s", "", fault)  # one of every set, of other times, displaces no others
            self._faults.pop(kind, None)
            self._faults[kind] = fault
            if len(self._faults) > FAULTS:
                del self._faults[next(iter(self._faults))]


def _misfit(image: object, camera: Camera) -> str | None:
    """Return why an image does not fit its camera; None if it does, or there is none."""
    shape = camera.height, camera.width, 3
    if image is None:
        return None
    if not isinstance(image, np.ndarray) or image.dtype != np.uint8 or image.shape[2:] != shape[2:]:
        return f"found {shown(image)}, expected uint8 of {shape}"
    if image.shape == shape:
        return None
    found = f"{image.shape[1]}x{image.shape[0]}"
    return f"found {found} px, expected {camera.width}x{camera.height} as it is calibrated"
