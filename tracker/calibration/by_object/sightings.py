"""Where a known object was in recordings and sets of images, at rest or in poses that differ."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tracker.conventions import FloatArray, Image
from tracker.errors import CalibrationError
from tracker.geometry import so3
from tracker.geometry.camera import Camera
from tracker.logs.log import Log, evenly, picked
from tracker.pipeline import ObjectTracker

Images = Sequence[Image | None]
"""(H, W, 3) BGR of each camera of a rig, None where it gave none."""


class Shot(NamedTuple):
    """What the cameras gave at one moment."""

    number: int
    images: Images
    stamps: FloatArray | None
    """(C,) when the pictures were taken [s]; None: at a moment of their own."""
    begins: bool
    """Whether what was before does not matter."""


def require_two(cameras: Sequence[Camera], what: str, why: str = "") -> None:
    """Refuse a rig of one camera; CalibrationError names what asks, and why."""
    if len(cameras) < 2:
        raise CalibrationError(f"{what}: found {cameras[0].name} alone, expected two cameras or more{why}")


class Footage:
    """A recording, open as long as this is used, or sets of pictures, each taken at a moment of its own.

    stills: each of the recording's frames was taken at a moment of its own.
    """

    def __init__(self, source: Log | Sequence[Images], *, stills: bool = False) -> None:
        self._source, self._stills = source, stills or len(source) == 1

    def shots(self) -> Iterator[Shot]:
        """All of it, in order."""
        log = self._source
        if not isinstance(log, Log):
            yield from (Shot(k, images, None, True) for k, images in enumerate(log))
            return
        starts = frozenset(log.episode_starts)
        alone = {index for index in starts if index + 1 in starts or index + 1 == len(log)}
        for frame in log:
            still = self._stills or frame.index in alone
            stamps = None if still else frame.camera_timestamps
            yield Shot(frame.index, frame.images, stamps, still or frame.index in starts)

    def images(self, numbers: Sequence[int]) -> Iterator[Images]:
        """The pictures of some shots, by number, which ascend."""
        source = self._source
        if isinstance(source, Log):
            return (frame.images for frame in picked(source, numbers))
        return (source[number] for number in numbers)


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


def all_sightings(
    tracker: ObjectTracker, footage: Sequence[Footage], least: float, progress: Callable[[int], None]
) -> list[list[Sighting]]:
    """The shots of each footage in which a tracker sees the object with a confidence of at least `least`.

    The tracker forgets what it saw before; `progress` takes each shot. LogError: a recording is damaged;
    ImageError: a picture is not what the tracker's cameras give.
    """
    seen: list[list[Sighting]] = []
    for one in footage:
        tracker.reset()
        seen.append([])
        begins = True
        for shot in one.shots():
            begins = begins or shot.begins
            found = _seen(tracker, shot, begins, least)
            if found is not None:
                seen[-1].append(found)
                begins = False
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


LEVEL = np.radians(6.0)
"""Greatest tilt of an object's face against z = 0: that of an object at rest, and of the world's [rad]."""

SLOW = 5e-3, np.radians(5.0)
"""Velocities below which an object may be at rest [m/s, rad/s]."""

FRAMES = 3
"""Frames in a row of a film in which it must be."""

SAME = 3e-3, np.radians(2.0)
"""Motion within which an object at rest is still in the same place [m, rad]."""


def resting(sightings: Iterable[Sighting]) -> list[Sighting]:
    """One sighting of each place in which the object may rest; every still that shows it level is one.

    It may be held still, too: who asks for rests must expect some of these.
    """
    runs: list[list[Sighting]] = []
    for one in sightings:
        level = np.abs(one.rotation[2]).max() > np.cos(LEVEL)
        if not level or not (one.velocity is None or slow(one.velocity)):
            continue
        run = [] if not runs or one.begins or one.velocity is None else runs[-1]
        if run and one.number == run[-1].number + 1 and _near(one, run[0], SAME):
            run.append(one)
        else:
            runs.append([one])
    return [run[len(run) // 2] for run in runs if run[0].velocity is None or len(run) >= FRAMES]


def slow(velocity: FloatArray) -> bool:
    """Whether an object with a velocity (6,) [m/s, rad/s] is at rest."""
    return bool((np.linalg.norm(velocity.reshape(2, 3), axis=1) < SLOW).all())


def _near(one: Sighting, other: Sighting, limits: tuple[float, float]) -> bool:
    """Whether the object moved and turned less than these limits [m, rad]."""
    moved = np.linalg.norm(one.position - other.position)
    return bool(moved < limits[0] and so3.angle_between(one.rotation, other.rotation) < limits[1])


APART = 8e-3, np.radians(8.0)
"""Motion from which on a pose is another one [m, rad]."""

LEAST = 18
"""Different poses that must be seen."""

TURNED = np.radians(30.0)
"""Turn between some of them [rad]: an object that is only moved shows the same edges."""

SPREAD = 0.03
"""Standard deviation of their places, as a length of all axes together [m]."""

SMEARED = 0.3e-3
"""Motion between the pictures of one frame beyond which it is left out [m]."""


def different(name: str, seen: Sequence[Sequence[Sighting]], most: int) -> list[list[Sighting]]:
    """Of each footage sightings in poses that differ, up to `most` in all; CalibrationError for too few."""
    sharp = [(k, one) for k, part in enumerate(seen) for one in part if _smear(one) < SMEARED]
    if not sharp:
        blurred = sum(map(len, seen))
        more = f"; in {blurred} more it moved between the cameras' pictures" if blurred else ""
        raise CalibrationError(f"refine: found no frame in which {name} is surely seen{more}")
    chosen: list[tuple[int, Sighting]] = []
    for k, one in sharp:
        if not any(_near(one, other, APART) for _, other in chosen):
            chosen.append((k, one))
    places = np.array([one.position for _, one in chosen])
    turn = max(so3.angle_between(one.rotation, chosen[0][1].rotation) for _, one in chosen)
    spread = float(np.sqrt(places.var(axis=0).sum()))
    if len(chosen) < LEAST or spread < SPREAD or turn < TURNED:
        raise CalibrationError(
            f"refine: found {len(chosen)} of the {LEAST} different poses or more in which {name} must be "
            f"seen; they spread by {1e3 * spread:.0f} mm (expected {1e3 * SPREAD:.0f}) and turn by up to "
            f"{np.degrees(turn):.0f}° (expected {np.degrees(TURNED):.0f}): move and turn it all over the "
            "arena"
        )
    taken = [chosen[k] for k in evenly(len(chosen), most)]
    return [[one for k, one in taken if k == footage] for footage in range(len(seen))]


def _smear(one: Sighting) -> float:
    """How far the object moved between the first and the last picture of a frame [m]."""
    return 0.0 if one.velocity is None else one.skew * float(np.linalg.norm(one.velocity[:3]))
