"""What the cameras gave at one moment, and what it showed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from tracker.conventions import Image
from tracker.errors import LiveError
from tracker.pose.result import CameraUse, MotionEstimate, Observation, PoseEstimate, Status


class SourceEnded(LiveError):
    """There are no more images, as was to be expected: a recording's end."""


@dataclass(frozen=True, eq=False)
class ImageSet:
    """What the cameras gave at one moment.

    Raises:
        LiveError: the counts differ, or a stamp is not finite.
    """

    images: tuple[Image | None, ...]
    """(H, W, 3) uint8 BGR of each camera in order, or None where it gave none."""
    stamps: tuple[float, ...]
    """When each image was taken [s]; where there is none, the moment at which it was missed."""
    faults: tuple[str | None, ...] = ()
    """What is wrong with each camera, in few words; None: nothing."""
    raw: tuple[Image | None, ...] | None = None
    """(H, W) raw Bayer pixels of each camera, red at even rows and columns; None where it gives colours."""
    age: float = 0.0
    """How long ago the latest image was taken when the set was handed over [s]."""
    fresh: bool = False
    """Whether something new begins, so that memory of what was before misleads."""

    def __post_init__(self) -> None:
        count = len(self.images)
        if not self.faults:
            object.__setattr__(self, "faults", (None,) * count)
        if not (count == len(self.stamps) == len(self.faults) and count):
            raise LiveError(f"taken: found {count} images and {len(self.stamps)} stamps, expected as many")
        if not np.isfinite(self.stamps).all():
            raise LiveError(
                f"taken: found the stamps {list(self.stamps)}, expected finite numbers of seconds"
            )

    @property
    def timestamp(self) -> float:
        """Stamp of the latest image; without any, the latest stamp [s]."""
        there = [t for image, t in zip(self.images, self.stamps, strict=True) if image is not None]
        return max(there or self.stamps)


class ImageSource(Protocol):
    """Gives sets of images; only the newest counts, those that were not fetched in time are left out."""

    def next(self, timeout: float) -> ImageSet | None:
        """The newest set that has not been given yet, waited for up to `timeout` [s]; None: none came.

        Raises:
            SourceEnded: none will come.
            TrackerError: the source cannot go on.
        """

    def close(self) -> None:
        """Free the cameras or files; called once, when nobody is in `next`."""


@dataclass(frozen=True, eq=False)
class Moment:
    """What one set of images showed."""

    sequence: int
    """Counts sets of images, from 0."""
    timestamp: float
    """When the latest of them was taken [s], on the source's clock."""
    observation: Observation
    """The tracker's answer."""
    taken: ImageSet
    """The images. Of moments that have passed, without them."""
    latency: float
    """From the latest image to the answer [s]."""
    faults: Mapping[str, str] = field(default_factory=dict)
    """What was wrong with this set, by the camera's name: no picture and why, one that was refused, one that
    is frozen or black."""
    jump: str | None = None
    """How the stamps of all cameras jumped since the set before; None: they went on as time does."""
    fault_counts: Mapping[str, int] = field(default_factory=dict)
    """In how many sets until this one something was wrong, by each camera's name; sets that nobody looked at
    count too."""
    jump_count: int = 0
    """How often stamps have jumped until now."""

    @property
    def object_pose(self) -> PoseEstimate | None:
        """The pose measured in these images, or None."""
        return self.observation.object_pose

    @property
    def filtered_object_pose(self) -> MotionEstimate | None:
        """Prediction and measurement fused over time, or None where the object is lost."""
        return self.observation.filtered_object_pose

    @property
    def status(self) -> Status:
        """Why there is a pose, or none."""
        return self.observation.status

    @property
    def cameras(self) -> tuple[CameraUse, ...]:
        """What became of each camera's picture."""
        return self.observation.cameras


def camera_faults(names: Sequence[str], taken: ImageSet, uses: Sequence[CameraUse]) -> dict[str, str]:
    """What was wrong with each camera, by its name; `uses`: what became of the images, or empty."""
    faults = {}
    for c, (name, image, fault) in enumerate(zip(names, taken.images, taken.faults, strict=True)):
        if image is None:
            faults[name] = fault or CameraUse.NO_IMAGE.value
        elif uses and uses[c] in (CameraUse.FROZEN, CameraUse.BLACK):
            faults[name] = uses[c].value
    return faults
