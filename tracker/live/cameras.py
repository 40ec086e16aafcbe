"""Trigger several cameras together, each in its own thread so that none waits for another."""

import contextlib
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import cv2
import numpy as np

from tracker.checks import is_number, one_stamp
from tracker.conventions import Image
from tracker.errors import LiveError, message, shown
from tracker.files import on_error
from tracker.live.moment import ImageSet, SourceEnded
from tracker.logs.log import Settings as Settings
from tracker.logs.pictures import from_bayer

RATE = 10.0
"""Sets of images per second [Hz], as on the platform."""

LOOK_AGAIN = 1.0
"""Interval between attempts to reopen a lost camera [s]."""

OPENING = 5.0
"""How long the first set waits for cameras that are being opened [s]."""

OPENING_LONG = 20.0
"""How long to wait if no camera is open yet, but an attempt to open one is still running [s]."""

_GRAB = 1.0
"""Longest time that a camera may take for an image [s]; the set is delivered without it long before."""

_UNTRIED = "not opened yet"


class CameraLost(LiveError):
    """The camera no longer answers; close it and try to open it again."""


class CameraUnfit(LiveError):
    """The camera is connected, but unusable with its settings; opening it again would not help."""


@dataclass(frozen=True, eq=False)
class Grabbed:
    """An image from a camera."""

    image: Image
    """(H, W, 3) uint8 BGR, or (H, W) raw Bayer pixels, red at even rows and columns."""
    stamp: float
    """Timestamp, on the clock of `time.time` [s]."""


class LiveCamera(Protocol):
    """A camera that has been opened.

    If it has a true attribute `film`, each set gets its next image, as if taken when the set was requested.
    """

    triggered: bool
    """Whether it takes images only on request; if not, it runs freely and `grab` returns the next image."""

    def grab(self, timeout: float) -> Grabbed:
        """Return an image within `timeout` [s]; CameraLost, SourceEnded, or LiveError if others may come."""

    def settings(self) -> Settings:
        """Return the current settings: exposure, gain and white balance, as far as it reports them."""

    def close(self) -> None:
        """Release the camera."""


@dataclass
class _Slot:
    """State that a camera's thread shares with the others."""

    answered: int = 0
    """Number of the newest requested set that the camera has answered."""
    picture: Grabbed | None = None
    """Its image; None: it failed, for the reason in `fault`."""
    spare: bool = False
    """Whether a free camera took it, and no set has it yet."""
    fault: str | None = _UNTRIED
    there: bool = False
    """Whether the camera is open."""
    final: LiveError | None = None
    """Why the whole source ends: the camera's film is over, or it was unusable when first opened."""
    settings: Settings | None = None
    """Settings when it was last opened; None: it never was."""


class CameraSet:
    """A source of images that cameras take when triggered together, at a steady rate.

    A camera that fails once has no image in that set. One that is lost or missing is opened once it is
    available. Sets continue at their rate, even if all cameras are lost. `next` raises LiveError, naming the
    cameras, only if none could be opened within seconds, if one was unusable with its settings when first
    opened (CameraUnfit), or if the film of one has ended (SourceEnded).

    Args:
        openers: one function per camera that opens it, or raises a LiveError naming the camera.
        sizes: width and height of each camera's images [px]; images of twice the size are halved.
        rate: sets per second [Hz].
    """

    def __init__(
        self,
        openers: Sequence[Callable[[], LiveCamera]],
        sizes: Sequence[tuple[int, int]],
        *,
        rate: float = RATE,
    ) -> None:
        if not is_number(rate) or not 0 < rate <= 1000:
            raise LiveError(f"cameras: rate: found {shown(rate)}, expected above 0 and up to 1000 Hz")
        self._sizes, self._period = list(sizes), 1 / rate
        self._changed = threading.Condition()
        self._slots = [_Slot() for _ in openers]
        self._asked, self._asked_at, self._deadline, self._waiting = 0, 0.0, 0.0, False
        self._raw = True  # until a camera gives a colour image: sets without it would alternate in size
        self._closing = threading.Event()
        self._tick = time.monotonic()
        self._begun_by = self._tick + OPENING
        self._threads = [
            threading.Thread(target=self._run, args=(slot, opener), name="tracker.camera", daemon=True)
            for slot, opener in zip(self._slots, openers, strict=True)
        ]
        for thread in self._threads:
            thread.start()

    def next(self, timeout: float) -> ImageSet | None:
        """See `ImageSource`."""
        until = time.monotonic() + timeout
        if not self._begun(until):
            return None
        if not self._waiting:
            if self._asked == 0:
                self._tick = time.monotonic()
            if self._tick > until:
                time.sleep(timeout)
                return None
            time.sleep(max(0.0, self._tick - time.monotonic()))
            now = time.monotonic()
            # A caller that is late does not receive the sets that it missed.
            self._tick = max(self._tick, now - self._period) + self._period
            with self._changed:
                self._asked, self._asked_at = self._asked + 1, time.time()
                self._deadline, self._waiting = now + max(0.9 * self._period, 0.02), True
                self._changed.notify_all()
        with self._changed:
            left = max(0.0, min(until, self._deadline) - time.monotonic())
            if not self._changed.wait_for(self._complete, left) and time.monotonic() < self._deadline:
                return None
            self._waiting = False
            for slot in self._slots:
                if slot.final is not None:
                    raise slot.final
            pictures, faults = [], []
            for slot in self._slots:
                pictures.append(slot.picture if slot.spare or slot.answered == self._asked else None)
                faults.append(slot.fault or "no image in time")
                slot.spare = False
        return self._image_set(pictures, faults)

    @property
    def settings(self) -> tuple[Settings, ...]:
        """Settings of each camera when it was last opened; empty if it never was."""
        with self._changed:
            return tuple(slot.settings or {} for slot in self._slots)

    def close(self) -> None:
        """See `ImageSource`."""
        self._closing.set()
        with self._changed:
            self._changed.notify_all()
        until = time.monotonic() + 2 * _GRAB
        for thread in self._threads:
            thread.join(max(0.0, until - time.monotonic()))

    def _begun(self, until: float) -> bool:
        """Return whether sets may begin: cameras get time to open, so that the first sets are complete."""
        with self._changed:
            opening = max(0.0, min(until, self._begun_by) - time.monotonic())
            tried = self._changed.wait_for(
                lambda: all(slot.fault is not _UNTRIED for slot in self._slots), opening
            )
            late = time.monotonic() - self._begun_by
            none = late >= 0 and all(slot.settings is None for slot in self._slots)
            if none and (tried or late > OPENING_LONG - OPENING):
                found = "; ".join(dict.fromkeys(str(slot.fault) for slot in self._slots))
                raise LiveError(f"cameras: not one of {len(self._slots)} could be opened: {found}")
            return tried or late >= 0

    def _complete(self) -> bool:
        """Return whether all cameras have answered, except lost ones and those hanging for over two sets."""
        late = [self._asked - slot.answered for slot in self._slots]
        if all(late):
            return not any(slot.there for slot in self._slots)  # if all are late, wait
        return not any(slot.there and 0 < sets <= 2 for sets, slot in zip(late, self._slots, strict=True))

    def _image_set(self, pictures: Sequence[Grabbed | None], faults: Sequence[str]) -> ImageSet:
        now = time.time()
        pixels = tuple(None if one is None else one.image for one in pictures)
        # An image that comes too late was taken after its set was asked for, perhaps before it was missed.
        stamps = tuple(self._asked_at if one is None else one.stamp for one in pictures)
        missing = tuple(why if one is None else None for one, why in zip(pixels, faults, strict=True))
        images = tuple(
            None if one is None else _developed(one, size)
            for one, size in zip(pixels, self._sizes, strict=True)
        )
        taken = [one for one in pictures if one is not None]
        self._raw &= all(one.image.ndim == 2 for one in taken)
        age = max(0.0, now - max((one.stamp for one in taken), default=now))
        return ImageSet(images, stamps, missing, pixels if taken and self._raw else None, age)

    def _run(self, slot: _Slot, opener: Callable[[], LiveCamera]) -> None:
        while not (slot.final or self._closing.is_set()):
            next_try = time.monotonic() + LOOK_AGAIN
            try:
                camera = opener()
                with on_error(camera.close):
                    settings = camera.settings()
            except Exception as error:
                with self._changed:
                    slot.fault = message(error)
                    if isinstance(error, CameraUnfit) and slot.settings is None:
                        slot.final = error
                    self._changed.notify_all()
            else:
                with self._changed:
                    slot.answered, slot.fault, slot.there = max(self._asked - 1, 0), None, True
                    slot.settings = settings
                    self._changed.notify_all()
                self._ask(slot, camera)
                with contextlib.suppress(Exception):  # it may be gone already
                    camera.close()
            self._closing.wait(next_try - time.monotonic())

    def _ask(self, slot: _Slot, camera: LiveCamera) -> None:
        """Grab images until the camera is lost or has ended, or the source is closed."""
        while slot.there:
            with self._changed:
                if camera.triggered or slot.fault is not None:  # or one that fails would spin
                    self._changed.wait_for(lambda: slot.answered < self._asked or self._closing.is_set())
                film, asked_at = getattr(camera, "film", False), self._asked_at
                # A film stays in step: sets that no longer wait for it get their images, too.
                requested = slot.answered + 1 if film else self._asked
            if self._closing.is_set():
                return
            picture, fault, there, final = None, None, True, None
            try:
                picture = _checked(camera.grab(_GRAB))
                picture = Grabbed(picture.image, asked_at) if film else picture  # decoding takes its time
            except Exception as error:
                fault = message(error)
                there = isinstance(error, LiveError) and not isinstance(error, CameraLost | SourceEnded)
                final = error if isinstance(error, SourceEnded) else None
            with self._changed:
                # A free camera answers the set that waits when its image arrives; if none waits, the next.
                slot.answered = requested if camera.triggered else self._asked
                slot.picture, slot.fault, slot.spare = picture, fault, not camera.triggered
                slot.there, slot.final = there, final
                self._changed.notify_all()


def _checked(picture: Grabbed) -> Grabbed:
    """Return a picture of uint8, BGR (H, W, 3) or raw (H, W), at a valid time; else raise LiveError."""
    image: Any = picture.image
    one_stamp(picture.stamp, "stamp", LiveError)
    fits = isinstance(image, np.ndarray) and image.dtype == np.uint8 and image.size
    if not fits or (image.shape[2:] != (3,) and image.ndim != 2):
        raise LiveError(f"found {shown(image)}, expected uint8 (H, W, 3), or (H, W) if raw")
    return picture


def _developed(image: Image, size: tuple[int, int]) -> Image:
    """Return an image as BGR (H, W, 3), halved if the calibration is for half its size."""
    image = from_bayer(image) if image.ndim == 2 else image
    height, width = image.shape[:2]
    if (width, height) == (2 * size[0], 2 * size[1]):
        return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
    return image
