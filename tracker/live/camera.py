"""One camera as every kind of them looks to a set of cameras."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from tracker.conventions import Image
from tracker.errors import LiveError
from tracker.live.shot import SourceEnded
from tracker.logs.source import Settings as Settings


class CameraLost(LiveError):
    """The camera does not answer any more; it is to be closed and looked for again."""


class CameraUnfit(LiveError):
    """The camera is there, but cannot be used as it is set: to look for it again mends nothing."""


class CameraEnded(SourceEnded):
    """The camera has no more pictures, as was to be expected: a film's end."""


class GrabFailed(LiveError):
    """This picture failed; the next may come."""


@dataclass(frozen=True, eq=False)
class Picture:
    """What a camera gave."""

    image: Image
    """(H, W, 3) uint8 BGR, or (H, W) raw Bayer pixels, red at even rows and columns."""
    stamp: float
    """When it was taken, on the clock of `time.time` [s]."""


class Camera(Protocol):
    """A camera that has been opened."""

    triggered: bool
    """Whether it takes a picture only when asked; else it runs freely, and `grab` gives the next."""

    def grab(self, timeout: float) -> Picture:
        """A picture, waited for up to `timeout` [s].

        Raises:
            GrabFailed: there is none this time.
            CameraLost: there will be none.
            CameraEnded: there are no more.
        """

    def settings(self) -> Settings:
        """What it is set to now: exposure, gain, white balance, as far as it tells them."""

    def close(self) -> None:
        """Free it."""
