"""Where the object was in a film or in stills, and how it moved."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from tracker.conventions import FloatArray
from tracker.pipeline import ObjectTracker
from tracker.upkeep.footage import Footage, Shot


@dataclass(frozen=True, eq=False)
class Sighting:
    """The object in one shot."""

    number: int
    """Of the shot."""
    position: FloatArray
    """(3,) [m]."""
    rotation: FloatArray
    """(3, 3) world_from_object."""
    velocity: FloatArray | None
    """(6,) [m/s, rad/s]; None in a still."""
    skew: float
    """Time between the first and the last picture [s]."""
    begins: bool
    """Whether no sighting before it belongs to the same film."""


def sightings(tracker: ObjectTracker, footage: Footage, least: float) -> Iterator[Sighting]:
    """The shots in which a tracker sees the object with a confidence of at least `least`.

    The tracker forgets what it saw before.

    Raises:
        LogError: the recording is damaged.
        ImageError: a picture is not what the tracker's cameras give.
    """
    tracker.reset()
    begins = True
    for shot in footage.shots():
        begins = begins or shot.begins
        seen = _seen(tracker, shot, begins, least)
        if seen is not None:
            yield seen
            begins = False


def all_sightings(
    tracker: ObjectTracker, footage: Sequence[Footage], least: float, progress: Callable[[int], None]
) -> list[list[Sighting]]:
    """Those of each footage; arguments and errors as of `sightings`, `progress` is told of each."""
    seen: list[list[Sighting]] = []
    for one in footage:
        seen.append([])
        for sighting in sightings(tracker, one, least):
            seen[-1].append(sighting)
            progress(1)
    return seen


def _seen(tracker: ObjectTracker, shot: Shot, begins: bool, least: float) -> Sighting | None:
    if all(image is None for image in shot.images):
        return None
    if shot.begins:
        tracker.reset()
    if shot.stamps is None:
        found, velocity, skew = tracker.detect(shot.images), None, 0.0
    else:
        given = shot.stamps[np.isfinite(shot.stamps)]
        found = tracker.update(shot.images, shot.stamps.tolist())
        filtered = found.filtered_object_pose
        velocity, skew = filtered.velocity if filtered is not None else None, float(np.ptp(given))
    pose = found.object_pose
    if pose is None or pose.confidence < least or (shot.stamps is not None and velocity is None):
        return None
    return Sighting(shot.number, pose.position, pose.rotation, velocity, skew, begins)
