"""All that `update` remembers: one value, replaced when a set of pictures was taken in as a whole."""

from __future__ import annotations

from typing import NamedTuple

from tracker.conventions import Array
from tracker.pose.fit import LIKELY, Start
from tracker.pose.result import Observation
from tracker.tracking.agreement import Agreement
from tracker.tracking.belief import Belief, TrackingOptions
from tracker.tracking.cameras import CameraMemory


class Memory(NamedTuple):
    """What is known before the next pictures."""

    belief: Belief
    """Of the object."""
    cameras: tuple[CameraMemory, ...]
    lights: Array | None = None
    """(C,) of PICTURE, of the last pictures: their light as last looked at."""
    start: Start = LIKELY
    """What the unknowns beside the pose were in the last pictures."""
    agreement: Agreement = Agreement()
    """Of how far the calibration is off."""
    latest: Observation | None = None
    """The last answer."""

    @classmethod
    def empty(cls, cameras: int, options: TrackingOptions | None = None) -> Memory:
        """Of a tracker that has seen nothing."""
        return cls(Belief(options or TrackingOptions()), (CameraMemory(),) * cameras)
