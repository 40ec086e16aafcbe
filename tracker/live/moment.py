"""What one set of images showed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from tracker.live.shot import Shot
from tracker.pose.result import CameraUse, MotionEstimate, Observation, PoseEstimate, Status

_UNFIT = (CameraUse.FROZEN, CameraUse.BLACK)


@dataclass(frozen=True, eq=False)
class Moment:
    """What one set of images showed."""

    sequence: int
    """Counts sets of images, from 0."""
    timestamp: float
    """When the latest of them was taken [s], on the source's clock."""
    observation: Observation
    """The tracker's answer."""
    shot: Shot
    """The images. Of moments that have passed, without them."""
    latency: float
    """From the latest image to the answer [s]."""
    faults: Mapping[str, str] = field(default_factory=dict)
    """What was wrong with this set, by the camera's name: no picture and why, one that was refused, one that
    is frozen or black."""
    jump: str | None = None
    """How the stamps of all cameras jumped since the set before; None: they went on as time does."""
    fault_counts: Mapping[str, int] = field(default_factory=dict)
    """In how many sets until this one something was wrong, by each camera's name: who looks at some moments
    only sees by them what the others had."""
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


def camera_faults(names: Sequence[str], shot: Shot, uses: Sequence[CameraUse]) -> dict[str, str]:
    """What was wrong with each camera, by its name; those that were well are left out.

    Args:
        names: of the cameras.
        shot: the images.
        uses: what became of them; empty where nobody knows.
    """
    faults = {}
    for c, (name, image, fault) in enumerate(zip(names, shot.images, shot.faults, strict=True)):
        if image is None:
            faults[name] = fault or CameraUse.NO_IMAGE.value
        elif uses and uses[c] in _UNFIT:
            faults[name] = uses[c].value
    return faults


def without_images(moment: Moment) -> Moment:
    """A moment that has passed: 256 sets of images would be gigabytes."""
    shot = replace(moment.shot, images=(None,) * len(moment.shot.images), raw=None)
    return replace(moment, shot=shot)
