"""Live: a tracker in a thread of its own, and the newest of what it finds for whoever asks."""

from __future__ import annotations

import os
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace
from types import TracebackType

import numpy as np

from tracker.conventions import Image
from tracker.errors import LiveError
from tracker.live.moment import Moment, camera_faults, without_images
from tracker.live.opening import FORMS, open_source
from tracker.live.shot import Shot, Source, SourceEnded
from tracker.pipeline import ObjectTracker
from tracker.pose.result import MotionEstimate
from tracker.warm_up import load

HISTORY = 256
"""Moments that are kept: 25 s of cameras at 10 Hz. Only the newest keeps its images."""

STAMPS_APART = 1.0
"""Farthest that a camera's stamp may be from the others' [s]; one that is farther does not count."""

_PATIENCE = 0.1
"""How long the thread waits at a time [s], before it looks whether it has to end."""


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
            raises is not called again, and `faults` tells of it.
        history: moments that are kept for `at`.

    Raises:
        TrackerError: the source cannot be opened, or is none.
    """

    def __init__(
        self,
        source: Source | str | os.PathLike[str],
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
        self._error: Exception | None = None
        self._stopping, self._running = threading.Event(), True
        self._count = 0
        self._fault_counts = dict.fromkeys(tracker.rig.names, 0)
        self._jump_count = 0
        self._last: float | None = None
        self._begun = 0.0
        self._thread = threading.Thread(target=self._run, name="tracker.live", daemon=True)
        self._thread.start()

    def __enter__(self) -> Live:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def running(self) -> bool:
        """Whether more may come: neither closed, nor at the source's end, nor broken."""
        return self._running

    @property
    def error(self) -> Exception | None:
        """What broke the source or the tracker, None where nothing did."""
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
        """
        with self._changed:
            if after is None:
                number = self._count - 1
            else:
                number = after.sequence if isinstance(after, Moment) else int(after)
            self._changed.wait_for(lambda: self._count - 1 > number or not self._running, timeout)
            if self._count - 1 > number:
                return self._moments[-1][0]
            if self._error is not None:
                raise LiveError(f"live: {self._error}") from self._error
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
            known = next(
                (known for known in reversed(self._moments) if known[0].timestamp <= timestamp), None
            )
        return None if known is None else known[1](timestamp)

    def close(self) -> None:
        """End the tracking, and close the source; called again it does nothing."""
        self._stopping.set()
        if self._thread is not threading.current_thread():
            self._thread.join()

    def _run(self) -> None:
        try:
            while not self._stopping.is_set():
                shot = self._source.next(_PATIENCE)
                if shot is not None:
                    self._take_in(shot)
        except SourceEnded:
            pass
        except Exception as error:
            self._error = error
        finally:
            try:
                self._source.close()
            except Exception as error:
                self._note(f"the source could not be closed: {error}")
            with self._changed:
                self._running = False
                self._changed.notify_all()

    def _take_in(self, shot: Shot) -> None:
        start = time.perf_counter()
        shot = self._checked(shot)
        if shot.timestamp == self._last and not shot.fresh:
            return  # the same set again, which is no news
        jump = self._jump(shot, start)
        anew = shot.fresh or (self._last is not None and shot.timestamp < self._last)
        if anew:
            self._tracker.reset()
        observation = self._tracker.update(shot.images, shot.stamps)
        self._last, self._begun = shot.timestamp, start
        faults = camera_faults(self._tracker.rig.names, shot, observation.cameras)
        if jump is not None:
            self._note(f"stamps {jump}")
        self._jump_count += jump is not None
        self._fault_counts = {name: n + (name in faults) for name, n in self._fault_counts.items()}
        latency = shot.age + time.perf_counter() - start
        moment = Moment(
            self._count, shot.timestamp, observation, shot, latency,
            faults, jump, self._fault_counts, self._jump_count,
        )  # fmt: skip
        with self._changed:
            if anew:
                self._moments.clear()
            if self._moments:
                old, forecast = self._moments[-1]
                self._moments[-1] = without_images(old), forecast
            self._moments.append((moment, self._tracker.forecast()))
            self._count += 1
            self._changed.notify_all()
        for listener in tuple(self._listeners):
            try:
                listener(moment)
            except Exception as error:
                self._listeners.remove(listener)
                self._note(f"a listener is not called any more: {error}")

    def _jump(self, shot: Shot, now: float) -> str | None:
        """How stamps jumped since the last set, which came at `_begun`; None: they went on as time does."""
        if self._last is None or shot.fresh:
            return None
        step, passed = shot.timestamp - self._last, now - self._begun
        if step < 0:
            return f"went back by {-step:.3f} s: what was before is forgotten"
        if step - passed > STAMPS_APART:
            return f"went on by {step:.3f} s within {passed:.3f} s"
        return None

    def _checked(self, shot: Shot) -> Shot:
        """The set without images that cannot be used, of which the others must not suffer."""
        rig = self._tracker.rig
        if len(shot.images) != len(rig):
            names = ", ".join(rig.names)
            raise LiveError(f"source: found {len(shot.images)} images, expected one for each of {names}")
        faults = dict(enumerate(shot.faults))
        middle = self._usual_stamp(shot)
        for c, (image, camera) in enumerate(zip(shot.images, rig, strict=True)):
            if image is None:
                continue
            shape = camera.height, camera.width, 3
            if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3:
                faults[c] = f"found {image.dtype} of shape {image.shape}, expected uint8 of {shape}"
            elif image.shape != shape:
                found = f"{image.shape[1]}x{image.shape[0]}"
                faults[c] = f"found {found} px, expected {camera.width}x{camera.height} as it is calibrated"
            elif abs(shot.stamps[c] - middle) > STAMPS_APART:
                faults[c] = f"its stamp is {shot.stamps[c] - middle:+.3f} s from the others'"
            else:
                continue
            self._note(f"{camera.name}: {faults[c]}")
        unusable = {c for c, fault in faults.items() if fault != shot.faults[c]}
        if not unusable:
            return shot

        def usable(images: Sequence[Image | None]) -> tuple[Image | None, ...]:
            return tuple(None if c in unusable else image for c, image in enumerate(images))

        return replace(
            shot,
            images=usable(shot.images),
            raw=None if shot.raw is None else usable(shot.raw),  # one of another size would end a recording
            stamps=tuple(middle if c in unusable else stamp for c, stamp in enumerate(shot.stamps)),
            faults=tuple(faults.values()),
        )

    def _usual_stamp(self, shot: Shot) -> float:
        """The stamp that most agree with; of two that differ, the one that follows on what was before."""
        given = [t for image, t in zip(shot.images, shot.stamps, strict=True) if image is not None]
        if len(given) == 2 and self._last is not None:
            last = self._last
            return min(given, key=lambda stamp: abs(stamp - last))
        return float(np.median(given or shot.stamps))

    def _note(self, fault: str) -> None:
        with self._changed:
            if fault in self._faults:  # each second ten of a camera's would drive out all others
                self._faults.remove(fault)
            self._faults.append(fault)
