"""Sources: recordings, the simulated platform, images that the caller has; and all sources by their words."""

from __future__ import annotations

import contextlib
import functools
import os
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tracker.calibration.rig import CameraRig
from tracker.checks import check_sequence, seconds
from tracker.conventions import FloatArray, Image
from tracker.errors import LiveError, TrackerError, install
from tracker.files.toml import read_toml
from tracker.live.cameras import RATE, CameraSet, LiveCamera
from tracker.live.drivers import OpenCvCamera, PylonCamera, pylon_serials
from tracker.live.moment import ImageSet, ImageSource, SourceEnded
from tracker.logs import Log, open_log
from tracker.pipeline import ObjectTracker

if TYPE_CHECKING:
    from synthetic.frames import Frame, FrameMaker

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


FRAMES = 40
"""Of the film, four seconds; drawing takes some tenths of a second each."""

_PERIOD = 0.1
"""Between its frames [s]."""


class Simulation:
    """A source that shows a film of the generator `synthetic`, at 10 Hz without end.

    The generator is looked for when it is needed only: the tracker does not rest on it. Faults are raised
    at once; the film is drawn by `draw`, or when the first pictures are asked for, which then come late.

    Args:
        object_name: what is seen.
        seed: of the film.
        frames: its length.

    Raises:
        LiveError: what the generator needs is not installed.
        TrackerError: it knows no such object.
    """

    def __init__(self, object_name: str, *, seed: int = 0, frames: int = FRAMES) -> None:
        self._maker = _maker(object_name, seed, frames)
        self._undrawn: Iterator[Frame] = self._maker.chunk(0)
        self._sets: list[tuple[Image | None, ...]] = []
        self._drawn = False
        self.rig: CameraRig = self._maker.rig
        self._start, self._number = float("nan"), -1

    def draw(self, seconds: float = float("inf")) -> bool:
        """Draw what is not drawn yet of the film, for so long at most [s]; whether all of it is."""
        until = time.monotonic() + seconds
        while not self._drawn and time.monotonic() < until:
            frame = next(self._undrawn, None)
            if frame is None:
                self._drawn = True
                self._sets += self._sets[-2:0:-1]  # there and back
                self._maker.close()
            else:
                self._sets.append(tuple(frame.images))
        return self._drawn

    def next(self, timeout: float) -> ImageSet | None:
        """See `ImageSource`."""
        until = time.time() + timeout
        if not self.draw(timeout):
            return None
        if self._number < 0:
            self._start = time.time()
        due = self._start + (self._number + 1) * _PERIOD
        time.sleep(max(0.0, min(due, until) - time.time()))
        if due > until:
            return None
        self._number = int((time.time() - self._start) / _PERIOD)
        stamp = self._start + self._number * _PERIOD
        images = self._sets[self._number % len(self._sets)]
        return ImageSet(images, (stamp,) * len(images), age=max(0.0, time.time() - stamp))

    def close(self) -> None:
        """See `ImageSource`."""
        self._maker.close()


def _maker(object_name: str, seed: int, frames: int) -> FrameMaker:
    # Its name is not its own: another package may have it.
    found = find_spec("synthetic") is not None and find_spec("synthetic.frames") is not None
    if not found or find_spec("pybullet") is None:
        raise LiveError(f"simulation: found no generator: {install('synthetic')}")
    from synthetic.frames import FrameMaker, FrameOptions

    return FrameMaker(
        FrameOptions(object_name, seed, quality="fast", sequence=True, dropped=0.0, length=frames)
    )


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


CAMERAS, SIMULATION = ("pylon", "opencv"), "simulation"
FORMS = "a recording's path, pylon, pylon:SERIAL,…, opencv:0,1,2 or simulation"


def open_source(source: str | os.PathLike[str], tracker: ObjectTracker) -> ImageSource:
    """The source that a text names, for the tracker's cameras: see FORMS.

    Raises:
        TrackerError: it cannot be opened.
    """
    text = os.fspath(source)
    kind = text.partition(":")[0]
    if kind in CAMERAS:
        return open_cameras(text, tracker.rig)
    if text == SIMULATION:
        simulation = Simulation(tracker.model.name)
        own, its = (
            [[*camera.matrix.ravel(), *camera.camera_from_world.ravel()] for camera in rig]
            for rig in (simulation.rig, tracker.rig)
        )
        if len(own) != len(its) or not np.allclose(own, its):
            simulation.close()
            raise LiveError(
                "simulation: found a tracker of other cameras; expected a tracker.live.Simulation in "
                "place of the word, and a tracker of its rig"
            )
        return simulation
    return Replay(text)


def open_cameras(
    source: str, rig: CameraRig, *, rate: float = RATE, settings: Path | None = None
) -> CameraSet:
    """The cameras that a text names, one for each of a rig's, in its order.

    Args:
        source: `pylon`, whose cameras call themselves as the rig's; `pylon:SERIAL,…`; or `opencv:…` with
            numbers, films or addresses.
        rig: says how large the images are.
        rate: sets of pictures per second [Hz].
        settings: a TOML file of what `pylon`'s cameras are set to: features by their GenICam names, those of
            a table `["SERIAL"]` for one camera only.

    Raises:
        LiveError: the text names none or too few, a setting cannot be read, or a camera is not there.
    """
    kind, _, listed = source.partition(":")
    which = [part.strip() for part in listed.split(",") if part.strip()]
    sizes = [(camera.width, camera.height) for camera in rig]
    openers: list[Callable[[], LiveCamera]]
    if kind == "pylon":
        which = which or pylon_serials(rig.names)
        chosen = settings_of(settings, which)
        openers = [functools.partial(PylonCamera, serial, chosen[serial]) for serial in which]
    elif kind == "opencv" and settings is None:
        openers = [
            functools.partial(OpenCvCamera, one, size) for one, size in zip(which, sizes, strict=False)
        ]
    else:
        found = f"settings for {kind}" if kind == "opencv" else repr(source)
        raise LiveError(f"source: found {found}, expected {FORMS}")
    if len(which) != len(rig):
        raise LiveError(
            f"source {source}: found {len(which)} cameras, expected one for each of {', '.join(rig.names)}"
        )
    return CameraSet(openers, sizes, rate=rate)


def settings_of(path: Path | None, serials: list[str]) -> dict[str, Mapping[str, Any]]:
    """What each camera is set to, from a TOML file; LiveError where that is malformed."""
    values = {} if path is None else read_toml(path, LiveError, what="settings")
    tables = {name: values.pop(name) for name in sorted(values) if isinstance(values[name], dict)}
    for serial in tables:
        if serial not in serials:
            raise LiveError(f"settings {path}: found [{serial}], expected one of {', '.join(serials)}")
    chosen: dict[str, Mapping[str, Any]]
    chosen = {serial: {**values, **tables.get(serial, {})} for serial in serials}
    for name, value in (item for one in chosen.values() for item in one.items()):
        if not isinstance(value, (str, int, float, bool)):
            raise LiveError(
                f"settings {path}: {name}: found {value!r}, expected a text, number, true or false"
            )
    return chosen
