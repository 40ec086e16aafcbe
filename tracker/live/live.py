"""Live: a tracker in a thread of its own, and the newest of what it finds on request."""

from __future__ import annotations

import os
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from tracker.errors import LiveError
from tracker.live.moment import ImageSet, ImageSource, Moment, SourceEnded, camera_faults
from tracker.live.sources import FORMS, open_source
from tracker.pipeline import ObjectTracker
from tracker.pose.result import MotionEstimate
from tracker.warm_up import load

HISTORY = 256
"""Moments that are kept: 25 s of cameras at 10 Hz. Only the newest keeps its images."""

STAMPS_APART = 1.0
"""Farthest that a camera's stamp may be from the others' [s]; one that is farther does not count."""

_PATIENCE = 0.1
"""How long the thread waits at a time [s], before it looks whether it has to end."""

CLOSING = 5.0
"""How long `close` waits for a source that does not return [s]."""


class Live:
    """Tracks what a source shows, from the moment it is made until `close`; a context manager.

    The tracker runs in a thread of its own and belongs to it: do not call its `update` or `reset`. A set of
    images that came while the one before was worked on waits; of several, the newest. Nothing that is asked
    here waits for the tracker, but `wait`.

    Args:
        source: where images come from, which is closed at the end; or what `open_source` takes: a recording's
            path, `pylon`, `opencv:0,1,2`, `simulation`.
        tracker: finds the object.
        listeners: are called in the tracking thread with each Moment, and must return quickly. One that
            raises is not called again, and `faults` names it.
        history: moments that are kept for `at`.

    Raises:
        TrackerError: the source cannot be opened, or is none.
    """

    def __init__(
        self,
        source: ImageSource | str | os.PathLike[str],
        tracker: ObjectTracker,
        *,
        listeners: Sequence[Callable[[Moment], None]] = (),
        history: int = HISTORY,
    ) -> None:
        if isinstance(tracker, ObjectTracker):
            load()
        if isinstance(source, (str, os.PathLike)):
            source = open_source(source, tracker)
        if not callable(getattr(source, "next", None)):
            raise LiveError(
                f"source: found {type(source).__name__}, expected one as those of tracker.live, Replay of "
                f"a recording among them, or {FORMS}"
            )
        self._source = source
        self._tracker = tracker
        self._listeners = list(listeners)
        self._changed = threading.Condition()
        self._moments: deque[tuple[Moment, Callable[[float], MotionEstimate | None]]] = deque(maxlen=history)
        self._faults: deque[str] = deque(maxlen=100)
        self._error: BaseException | None = None
        self._stopping, self._running, self._working = threading.Event(), True, False
        self._count = 0
        self._fault_counts = dict.fromkeys(tracker.rig.names, 0)
        self._jump_count = 0
        self._last: float | None = None
        self._begun = 0.0
        self._thread = threading.Thread(target=self._run, name="tracker.live", daemon=True)
        self._thread.start()

    def __enter__(self) -> Live:
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        self.close()
        if kind is None and self._error is not None and not isinstance(self._error, Exception):
            raise self._error

    @property
    def running(self) -> bool:
        """Whether more may come: neither closed, nor at the source's end, nor broken."""
        return self._running

    @property
    def error(self) -> BaseException | None:
        """What broke the source or the tracker, None where nothing did.

        A KeyboardInterrupt or SystemExit in the source is raised by `wait` as it is, and at the end of a
        with-statement that nothing else ended.
        """
        return self._error

    @property
    def faults(self) -> tuple[str, ...]:
        """What went wrong and was got over, each once, the last hundred of it."""
        with self._changed:
            return tuple(self._faults)

    def latest(self) -> Moment | None:
        """The newest moment, None before the first; its timestamp tells how old it is."""
        with self._changed:
            return self._moments[-1][0] if self._moments else None

    def wait(self, after: Moment | int | None = None, timeout: float | None = None) -> Moment | None:
        """The newest moment after another, as soon as there is one.

        Args:
            after: the moment, or its sequence number; None: the newest one at the call.
            timeout: how long to wait [s]; None: as long as it takes.

        Returns:
            None where none came in time, or none will come since the source has ended or this was closed.

        Raises:
            LiveError: the source or the tracker broke; the message says how.
            KeyboardInterrupt, SystemExit: the source raised it.
        """
        with self._changed:
            number = after.sequence if isinstance(after, Moment) else after
            seen = self._count if number is None else int(number) + 1
            self._changed.wait_for(lambda: self._count > seen or not self._running, timeout)
            if self._count > seen:
                return self._moments[-1][0]
            if isinstance(self._error, Exception):
                raise LiveError(f"live: {self._error}") from self._error
            if self._error is not None:
                raise self._error
            return None

    def at(self, timestamp: float) -> MotionEstimate | None:
        """The pose at a moment, on the clock of the source's stamps [s].

        It is predicted from the last images taken before, so that for a moment to come it is the pose then:
        images are late, and a control loop that acts at `timestamp` asks for the pose then. For one that has
        passed it is what was known from the images until then.

        Returns:
            None where the object was lost then, was seen too long before, or nothing is remembered.
        """
        with self._changed:
            earlier = (known for known in reversed(self._moments) if known[0].timestamp <= timestamp)
            _, forecast = next(earlier, (None, None))
        return None if forecast is None else forecast(timestamp)

    def close(self) -> None:
        """End the tracking, and close the source; called again it does nothing.

        A source that returns from `next` or `close` only after seconds is left to the thread, which closes it
        then; `faults` names it.
        """
        self._stopping.set()
        if self._thread is threading.current_thread():
            return
        until = time.monotonic() + CLOSING
        while self._running and (self._working or time.monotonic() < until):
            self._thread.join(_PATIENCE)
        if self._running:
            self._note(f"the source does not return: not closed after {CLOSING:g} s")
            self._end()

    def _run(self) -> None:
        try:
            while not self._stopping.is_set():
                taken = self._source.next(_PATIENCE)
                if taken is not None and not self._stopping.is_set():
                    self._working = True
                    self._take_in(taken)
                    self._working = False
        except SourceEnded:
            pass
        except BaseException as error:  # of this thread nobody else would see it
            self._error = error
        finally:
            self._working = False
            try:
                self._source.close()
            except Exception as error:
                self._note(f"the source could not be closed: {error}")
            self._end()

    def _end(self) -> None:
        with self._changed:
            self._running = False
            self._changed.notify_all()

    def _take_in(self, taken: ImageSet) -> None:
        start = time.perf_counter()
        taken = self._checked(taken)
        if taken.timestamp == self._last and not taken.fresh:
            return  # the same set again, which is no news
        jump = self._jump(taken, start)
        restarts = taken.fresh or (self._last is not None and taken.timestamp < self._last)
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
                self._moments.clear()
            if self._moments:  # whose images, of all that are kept, would be gigabytes
                old, forecast = self._moments[-1]
                passed = replace(old.taken, images=(None,) * len(taken.images), raw=None)
                self._moments[-1] = replace(old, taken=passed), forecast
            self._moments.append((moment, self._tracker.forecast()))
            self._count += 1
            self._changed.notify_all()
        for listener in tuple(self._listeners):
            try:
                listener(moment)
            except Exception as error:
                self._listeners.remove(listener)
                self._note(f"a listener is not called any more: {error}")

    def _jump(self, taken: ImageSet, now: float) -> str | None:
        """How stamps jumped since the last set, which came at `_begun`; None: they went on as time does."""
        if self._last is None or taken.fresh:
            return None
        step, passed = taken.timestamp - self._last, now - self._begun
        if step < 0:
            return f"went back by {-step:.3f} s: what was before is forgotten"
        if step - passed > STAMPS_APART:
            return f"went on by {step:.3f} s within {passed:.3f} s"
        return None

    def _checked(self, taken: ImageSet) -> ImageSet:
        """The set without images that cannot be used, of which the others must not suffer."""
        rig = self._tracker.rig
        if len(taken.images) != len(rig):
            names = ", ".join(rig.names)
            raise LiveError(f"source: found {len(taken.images)} images, expected one for each of {names}")
        middle = self._usual_stamp(taken)
        images, stamps, faults = list(taken.images), list(taken.stamps), list(taken.faults)
        raw = None if taken.raw is None else list(taken.raw)
        for c, (image, camera) in enumerate(zip(taken.images, rig, strict=True)):
            if image is None:
                continue
            shape = camera.height, camera.width, 3
            if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3:
                fault = f"found {image.dtype} of shape {image.shape}, expected uint8 of {shape}"
            elif image.shape != shape:
                found = f"{image.shape[1]}x{image.shape[0]}"
                fault = f"found {found} px, expected {camera.width}x{camera.height} as it is calibrated"
            elif abs(stamps[c] - middle) > STAMPS_APART:
                fault = f"its stamp is {stamps[c] - middle:+.3f} s from the others'"
            else:
                continue
            self._note(f"{camera.name}: {fault}")
            images[c], stamps[c], faults[c] = None, middle, fault
            if raw is not None:
                raw[c] = None  # one of another size would end a recording
        raws = None if raw is None else tuple(raw)
        return replace(taken, images=tuple(images), stamps=tuple(stamps), faults=tuple(faults), raw=raws)

    def _usual_stamp(self, taken: ImageSet) -> float:
        """The stamp that most agree with; of two that differ, the one that follows on what was before."""
        given = [t for image, t in zip(taken.images, taken.stamps, strict=True) if image is not None]
        if len(given) == 2 and self._last is not None:
            last = self._last
            return min(given, key=lambda stamp: abs(stamp - last))
        return float(np.median(given or taken.stamps))

    def _note(self, fault: str) -> None:
        with self._changed:
            if fault in self._faults:  # each second ten of a camera's would drive out all others
                self._faults.remove(fault)
            self._faults.append(fault)
