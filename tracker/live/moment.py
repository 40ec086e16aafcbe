"""The images of one moment, and the tracker's result on them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from tracker.checks import in_range, one_stamp, seconds, shown_in
from tracker.conventions import Image
from tracker.errors import LiveError
from tracker.pose.result import CameraUse, MotionEstimate, Observation, PoseEstimate, Status


class SourceEnded(LiveError):
    """There are no more images, as expected at the end of a recording."""


@dataclass(frozen=True, eq=False)
class ImageSet:
    """The cameras' images of one moment.

    Raises:
        LiveError: the numbers of images, timestamps and faults differ, or a time is not in seconds.
    """

    images: tuple[Image | None, ...]
    """Image (H, W, 3) uint8 BGR of each camera in order; None if it gave none."""
    stamps: tuple[float, ...]
    """Timestamp of each image [s]; for a missing image, the time at which it was requested."""
    faults: tuple[str | None, ...] = ()
    """What is wrong with each camera, in a few words; None: nothing."""
    raw: tuple[Image | None, ...] | None = None
    """Raw Bayer pixels (H, W) of each camera, red at even rows and columns; None for colour images."""
    age: float = 0.0
    """Age of the latest image when the set was delivered [s]."""
    fresh: bool = False
    """Whether the set is unrelated to earlier ones, so that the tracker must forget them."""

    def __post_init__(self) -> None:
        count = len(self.images)
        if not self.faults:
            object.__setattr__(self, "faults", (None,) * count)
        if not (count == len(self.stamps) == len(self.faults) and count):
            each = f"{count} images, {len(self.stamps)} stamps and {len(self.faults)} faults"
            raise LiveError(f"taken: found {each}, expected one of each for every camera")
        stamps = in_range(seconds(self.stamps, "taken: stamps", LiveError), "taken: stamps", LiveError)
        object.__setattr__(self, "stamps", tuple(stamps.tolist()))  # others cannot be written as JSON
        object.__setattr__(self, "age", one_stamp(self.age, "taken: age", LiveError))

    @property
    def timestamp(self) -> float:
        """Timestamp of the latest image [s], a black one only if there are no others; else the latest."""
        shown = shown_in(self.images)
        return max([t for t, one in zip(self.stamps, shown, strict=True) if one] or self.stamps)


class ImageSource(Protocol):
    """A source of image sets; only the newest counts, and sets not fetched in time are dropped."""

    def next(self, timeout: float) -> ImageSet | None:
        """Return the newest set not returned yet, waiting up to `timeout` [s]; None: none came.

        Raises:
            SourceEnded: no more sets will come.
            TrackerError: the source has failed.
        """

    def close(self) -> None:
        """Release the cameras or files; called once, never during `next`."""


@dataclass(frozen=True, eq=False)
class Moment:
    """The tracker's result on one set of images."""

    sequence: int
    """Number of the set of images, from 0."""
    timestamp: float
    """Timestamp of the latest image [s], on the source's clock."""
    observation: Observation
    """The tracker's result."""
    taken: ImageSet
    """The images."""
    latency: float
    """Time from the latest image, a pushed one from its `push`, to the result [s]."""
    faults: Mapping[str, str] = field(default_factory=dict)
    """Faults in this set, by camera name: an image that is missing (and why), rejected, frozen or black."""
    jump: str | None = None
    """How the timestamps of all cameras jumped since the previous set; None: they did not."""
    fault_counts: Mapping[str, int] = field(default_factory=dict)
    """Number of moments so far with a fault, by camera name; moments that were never fetched count, too."""
    jump_count: int = 0
    """Number of timestamp jumps so far."""

    @property
    def object_pose(self) -> PoseEstimate | None:
        """The pose measured in these images, or None."""
        return self.observation.object_pose

    @property
    def filtered_object_pose(self) -> MotionEstimate | None:
        """The pose from prediction and measurements fused over time, or None if the object is lost."""
        return self.observation.filtered_object_pose

    @property
    def status(self) -> Status:
        """Why there is a pose, or why not."""
        return self.observation.status

    @property
    def cameras(self) -> tuple[CameraUse, ...]:
        """How each camera's image was used."""
        return self.observation.cameras


def camera_faults(names: Sequence[str], taken: ImageSet, uses: Sequence[CameraUse]) -> dict[str, str]:
    """Return the faults of the cameras, by name; `uses`: how their images were used, or empty."""
    faults = {}
    for c, (name, image, fault) in enumerate(zip(names, taken.images, taken.faults, strict=True)):
        if image is None:
            faults[name] = fault or CameraUse.NO_IMAGE.value
        elif uses and uses[c] in (CameraUse.FROZEN, CameraUse.BLACK):
            faults[name] = uses[c].value
    return faults
