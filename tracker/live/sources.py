"""Image sources: recordings, the simulated platform, images from the caller; and opening sources by name."""

from __future__ import annotations

import contextlib
import functools
import math
import os
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tracker.calibration.rig import CameraRig
from tracker.checks import UNSTAMPED, check_sequence, in_range, is_number, of_kind, seconds
from tracker.conventions import FloatArray, Image
from tracker.errors import LiveError, TrackerError, install, shown
from tracker.files.toml import read_toml
from tracker.inputs import of_cameras
from tracker.live.cameras import RATE, CameraSet, LiveCamera
from tracker.live.drivers import OpenCvCamera, PylonCamera, pylon_serials
from tracker.live.moment import ImageSet, ImageSource, SourceEnded
from tracker.logs import Log, open_log
from tracker.logs.log import by_episode
from tracker.pipeline import ObjectTracker

if TYPE_CHECKING:
    from synthetic.frames import Frame, FrameMaker

_PAUSE = 0.1
"""Pause between two episodes [s], whose timestamps are unrelated."""


def _came(due: float, until: float) -> bool:
    """Wait for a time of `time.monotonic`, at most until another [s]; return whether it came."""
    time.sleep(max(0.0, min(due, until) - time.monotonic()))
    return due <= until


class Replay:
    """A source that replays a recording's frames at the pace of their timestamps.

    Timestamps are shifted to begin when the first frame is requested, on the clock of `time.time`. As with
    cameras, a frame not fetched before the next is due is dropped.

    Args:
        log: the recording, or its path.
        speed: speed relative to that of the recording.

    Raises:
        TrackerError: the recording cannot be opened, or the speed is not above zero.
    """

    def __init__(self, log: Log | str | os.PathLike[str], *, speed: float = 1.0) -> None:
        if not is_number(speed) or speed <= 0:
            raise LiveError(f"replay: speed: found {shown(speed)}, expected above 0")
        self.log = log if isinstance(log, Log) else open_log(log)
        self._speed = speed
        self._plan = self._planned()
        self._ahead: tuple[float, ImageSet] | TrackerError | None = None
        self.skipped = 0
        """Number of frames dropped because they were not fetched in time."""

    def next(self, timeout: float) -> ImageSet | None:
        """See `ImageSource`."""
        until = time.monotonic() + timeout
        due, found = self._coming()
        if not _came(due, until):
            return None
        fresh, self._ahead = found.fresh, None
        with contextlib.suppress(TrackerError):  # an error in the next frame does not affect this one
            # Reading takes time, too: a recording may come due faster than it can be read.
            while time.monotonic() < until and self._coming()[0] <= time.monotonic():
                due, found = self._coming()
                fresh, self._ahead, self.skipped = fresh or found.fresh, None, self.skipped + 1
        return replace(found, age=max(0.0, time.monotonic() - due), fresh=fresh)

    def close(self) -> None:
        """See `ImageSource`."""
        self.log.close()

    def _coming(self) -> tuple[float, ImageSet]:
        """Return when the next set is due [s], and the set; the same until `_ahead` is cleared."""
        if self._ahead is None:
            self._ahead = next(self._plan)
        if isinstance(self._ahead, TrackerError):
            raise self._ahead
        return self._ahead

    def _planned(self) -> Iterator[tuple[float, ImageSet] | TrackerError]:
        """Yield when each set is due, and the set with shifted timestamps; then why there are no more."""
        due = None
        begin = now = 0.0  # first timestamp of this episode, and the time to which it is shifted
        clock = time.time() - time.monotonic()  # the former may be set meanwhile
        try:
            for frame, fresh in by_episode(self.log):
                last = frame.newest
                if fresh:
                    begin, now = last, time.monotonic() if due is None else due + _PAUSE
                due = now + (last - begin) / self._speed
                moved = clock + now + (frame.stamps - begin) / self._speed
                faults = tuple("no image in the recording" if one is None else None for one in frame.images)
                yield due, ImageSet(frame.images, tuple(moved.tolist()), faults, raw=frame.raw, fresh=fresh)
        except TrackerError as error:
            yield error
        yield SourceEnded("recording: it has ended")


FRAMES = 40
"""Length of the simulated film [frames]: four seconds; rendering takes some tenths of a second per frame."""

_PERIOD = 0.1
"""Time between frames of the film [s]."""


class Simulation:
    """A source that plays a film from the generator `synthetic` at 10 Hz in an endless loop.

    The generator is imported only here: the tracker does not depend on it. Errors are raised at once. The
    film is rendered by `draw`, or when the first images are requested, which delays them.

    Args:
        object_name: the object in the film.
        seed: random seed of the film.
        frames: length of the film [frames].

    Raises:
        LiveError: the generator or one of its packages is not installed.
        TrackerError: the generator does not know the object.
    """

    def __init__(self, object_name: str, *, seed: int = 0, frames: int = FRAMES) -> None:
        self._maker = _maker(object_name, seed, frames)
        self._undrawn: Iterator[Frame] = self._maker.chunk(0)
        self._sets: list[tuple[Image | None, ...]] = []
        self._drawn, self._start, self._clock, self._number = False, math.nan, math.nan, -1
        self.rig: CameraRig = self._maker.rig

    def draw(self, seconds: float = float("inf")) -> bool:
        """Render frames of the film for at most `seconds` [s]; return whether all are rendered."""
        until = time.monotonic() + seconds
        while not self._drawn and time.monotonic() < until:
            frame = next(self._undrawn, None)
            if frame is None:
                self._drawn = True
                self._sets += self._sets[-2:0:-1]  # forwards, then backwards
                self._maker.close()
            else:
                self._sets.append(tuple(frame.images))
        return self._drawn

    def next(self, timeout: float) -> ImageSet | None:
        """See `ImageSource`."""
        until = time.monotonic() + timeout
        if not self.draw(timeout):
            return None
        if self._number < 0:
            self._start, self._clock = time.monotonic(), time.time() - time.monotonic()
        if not _came(self._start + (self._number + 1) * _PERIOD, until):
            return None
        self._number = int((time.monotonic() - self._start) / _PERIOD)
        due = self._start + self._number * _PERIOD
        images = self._sets[self._number % len(self._sets)]
        return ImageSet(images, (self._clock + due,) * len(images), age=max(0.0, time.monotonic() - due))

    def close(self) -> None:
        """See `ImageSource`."""
        self._maker.close()


def _maker(object_name: str, seed: int, frames: int) -> FrameMaker:
    # Another package may be named `synthetic`, too.
    found = find_spec("synthetic") is not None and find_spec("synthetic.frames") is not None
    if not found or find_spec("pybullet") is None:
        raise LiveError(f"simulation: found no generator: {install('synthetic')}")
    from synthetic.frames import FrameMaker, FrameOptions

    options = FrameOptions(object_name, seed, quality="fast", sequence=True, dropped=0.0, length=frames)
    return FrameMaker(options)


class Pushed:
    """A source of images that are pushed into it from any thread; a newer set replaces one still waiting."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._waiting: ImageSet | None = None
        self._ended, self._count, self._came = False, 0, 0.0
        self.replaced = 0
        """Number of sets that a newer one replaced before they were fetched."""

    def push(
        self,
        images: Sequence[Image | None],
        timestamp: float | Sequence[float | None] | FloatArray | None = None,
    ) -> None:
        """Push a set of images; return at once.

        Args:
            images: one image (H, W, 3) uint8 BGR per camera, None if there is none. They are not copied: do
                not write to them afterwards.
            timestamp: when they were taken [s], one for all cameras or one each (None or NaN without an
                image); by default `time.time()`.

        Raises:
            LiveError: the numbers of images and timestamps differ, there were more or fewer images before, a
                timestamp is not in seconds, or nobody fetches images any more.
        """
        stamp: Any = time.time() if timestamp is None else timestamp
        check_sequence(images, "images", LiveError)
        if isinstance(stamp, np.ndarray) and stamp.ndim == 1:
            stamp = list(stamp)
        if isinstance(stamp, (list, tuple)) and len(stamp) == len(images):
            latest = max((one for one in stamp if is_number(one)), default=None)
            unstamped = [one is None or (isinstance(one, float) and math.isnan(one)) for one in stamp]
            if latest is None and all(unstamped):
                raise LiveError(f"timestamp: {UNSTAMPED}")
            each = zip(stamp, images, unstamped, strict=True)
            stamp = [latest if image is None and missing else one for one, image, missing in each]
        given = in_range(seconds(stamp, "timestamp", LiveError), "timestamp", LiveError)
        stamps = given.ravel().tolist() * (1 if given.ndim else len(images))
        taken = ImageSet(tuple(images), tuple(stamps))
        with self._changed:
            if self._ended:
                raise LiveError("pushed images: found the source closed, expected a running one")
            if len(images) != (self._count or len(images)):
                raise LiveError(f"images: found {len(images)}, expected {self._count} as before")
            self._count = len(images)
            self.replaced += self._waiting is not None
            self._waiting, self._came = taken, time.monotonic()
            self._changed.notify_all()

    def finish(self) -> None:
        """Declare that no more images will come."""
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
            return taken and replace(taken, age=time.monotonic() - self._came)

    def close(self) -> None:
        """See `ImageSource`."""
        self.finish()


CAMERAS, SIMULATION = ("pylon", "opencv"), "simulation"
FORMS = "a recording's path, pylon, pylon:SERIAL,…, opencv:0,1,2 or simulation"


def open_source(source: str | os.PathLike[str], tracker: ObjectTracker) -> ImageSource:
    """Open the source named by a text, see FORMS, for the tracker's cameras; TrackerError if that fails."""
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
        if len(own) == len(its) and np.allclose(own, its):
            return simulation
        simulation.close()
        raise LiveError(
            "simulation: found a tracker of other cameras, expected a Simulation and a tracker of its rig"
        )
    replay, expected = Replay(text), tracker.rig.names
    found = replay.log.camera_names
    if found != expected and set(found) & set(expected):
        replay.close()
        raise LiveError(f"{text}: found images of {', '.join(found)}, expected {', '.join(expected)}")
    return replay


def open_cameras(
    source: str, rig: CameraRig, *, rate: float = RATE, settings: Path | None = None
) -> CameraSet:
    """Open the cameras named by a text, one for each camera of a rig, in its order.

    Args:
        source: `pylon`, for cameras whose DeviceUserIDs are the rig's names; `pylon:SERIAL,…`; or `opencv:…`
            with numbers, films or addresses. Films named after the cameras may come in any order.
        rig: gives the names and image sizes.
        rate: sets of images per second [Hz].
        settings: a TOML file of settings for `pylon`: features by their GenICam names; those in a table
            `["SERIAL"]` are for one camera only.

    Raises:
        LiveError: the text is malformed or names the wrong number of cameras, the settings cannot be read,
            or a camera with a name of the rig is missing.
        ImageError: films' names contradict the cameras.
    """
    of_kind(rig, CameraRig, "rig", LiveError, "tracker.CameraRig.load")
    kind, _, listed = of_kind(source, str, "source", LiveError).partition(":")
    which = [part.strip() for part in listed.split(",") if part.strip()]
    sizes = [(camera.width, camera.height) for camera in rig]
    openers: list[Callable[[], LiveCamera]]
    if kind == "pylon":
        which = which or pylon_serials(rig.names)
        chosen = settings_of(settings, which)
        openers = [functools.partial(PylonCamera, serial, chosen[serial]) for serial in which]
    elif kind == "opencv" and settings is None:
        if len(which) == len(rig) and all(map(os.path.isfile, which)):
            which = of_cameras(which, rig.names)
        openers = [functools.partial(OpenCvCamera, *one) for one in zip(which, sizes, strict=False)]
    else:
        found = f"settings for {kind}" if kind == "opencv" else repr(source)
        raise LiveError(f"source: found {found}, expected {FORMS}")
    if len(which) != len(rig):
        names = ", ".join(rig.names)
        raise LiveError(f"source {source}: found {len(which)} cameras, expected one for each of {names}")
    return CameraSet(openers, sizes, rate=rate)


def settings_of(path: Path | None, serials: list[str]) -> dict[str, dict[str, Any]]:
    """Return each camera's settings from a TOML file; LiveError if it is malformed."""
    values = {} if path is None else read_toml(path, LiveError, what="settings")
    tables = {name: values.pop(name) for name in sorted(values) if isinstance(values[name], dict)}
    for serial in tables:
        if serial not in serials:
            raise LiveError(f"settings {path}: found [{serial}], expected one of {', '.join(serials)}")
    chosen = {serial: {**values, **tables.get(serial, {})} for serial in serials}
    for name, value in (item for one in chosen.values() for item in one.items()):
        if not isinstance(value, (str, int, float, bool)):
            valid = "a text, number, true or false"
            raise LiveError(f"settings {path}: {name}: found {value!r}, expected {valid}")
    return chosen
