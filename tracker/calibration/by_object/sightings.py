"""Find a known object in recordings and sets of images: at rest, or in different poses."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np

from tracker.conventions import FloatArray, Image
from tracker.errors import CalibrationError
from tracker.geometry import so3
from tracker.geometry.camera import Camera
from tracker.logs.log import Log, by_episode, evenly, picked
from tracker.pipeline import SAMPLE, ObjectTracker, another_shown
from tracker.pose.result import MotionEstimate, Observation, PoseEstimate
from tracker.poses.columns import FilteredColumns, PoseColumns
from tracker.tracking.cameras import slow

Images = Sequence[Image | None]
"""Image (H, W, 3) BGR of each camera of a rig; None if it gave none."""


class Shot(NamedTuple):
    """The images of one moment."""

    number: int
    images: Images
    stamps: FloatArray | None
    """Timestamps (C,) for `ObjectTracker.update` [s]; None for stills, which are unrelated in time."""
    begins: bool
    """Whether the shot is unrelated to those before it."""


def require_two(cameras: Sequence[Camera], what: str, why: str = "") -> None:
    """Raise CalibrationError for a rig of one camera, naming the command `what` and the reason `why`."""
    if len(cameras) < 2:
        raise CalibrationError(f"{what}: found {cameras[0].name} alone, expected two cameras or more{why}")


class Footage:
    """A recording, which must stay open while this is used, or sets of images that are unrelated in time.

    stills: whether the recording's frames are unrelated in time, too.
    """

    def __init__(self, source: Log | Sequence[Images], *, stills: bool = False) -> None:
        self._source, self._stills = source, stills or len(source) == 1

    def shots(self) -> Iterator[Shot]:
        """Yield all shots in order."""
        log = self._source
        if not isinstance(log, Log):
            yield from (Shot(k, images, None, True) for k, images in enumerate(log))
            return
        starts = frozenset(log.episode_starts)
        alone = {index for index in starts if index + 1 in starts or index + 1 == len(log)}
        for frame, begins in by_episode(log):
            still = self._stills or frame.index in alone
            stamps = None if still else frame.stamps
            yield Shot(frame.index, frame.images, stamps, still or begins)

    def images(self, numbers: Sequence[int]) -> Iterator[Images]:
        """Return the images of the shots with these ascending numbers."""
        if isinstance(self._source, Log):
            return (frame.images for frame in picked(self._source, numbers))
        return map(self._source.__getitem__, numbers)


@dataclass(frozen=True, eq=False)
class Sighting:
    """The object as seen in one shot, at a position (3,) [m] with a rotation (3, 3) world_from_object."""

    footage: Footage
    number: int
    """Number of the shot."""
    position: FloatArray
    rotation: FloatArray
    velocity: FloatArray | None
    """(6,) [m/s, rad/s]; None in a still."""
    smear: FloatArray
    """(2,) motion between the first and the last image of the shot, RMS of what is known [m, rad]."""
    begins: bool
    """Whether it is the first sighting of its episode."""


def observed(tracker: ObjectTracker, footage: Footage) -> Iterator[tuple[Shot, Observation | None]]:
    """Yield the shots that have an image, and what a tracker sees in each; None for stills."""
    begins = True
    for shot in footage.shots():
        begins = begins or shot.begins
        if all(image is None for image in shot.images):
            continue
        if begins:
            tracker.reset()
        found = None if shot.stamps is None else tracker.update(shot.images, shot.stamps)
        yield shot._replace(begins=begins), found
        begins = False


def all_sightings(
    tracker: ObjectTracker, footage: Sequence[Footage], least: float, progress: Callable[[int], None]
) -> list[Sighting]:
    """Return the shots in which a tracker finds the object with at least the confidence `least`, in order.

    `progress` receives 1 for each. LogError: a recording is damaged; ImageError: an image does not suit the
    tracker's cameras; CalibrationError: the images show another object.
    """
    seen: list[Sighting] = []
    every: list[tuple[Footage, int]] = []
    for one in footage:
        begins = True
        for shot, tracked in observed(tracker, one):
            begins = begins or shot.begins
            every.append((one, shot.number))
            found = tracker.detect(shot.images) if tracked is None else tracked
            pose, motion = found.object_pose, found.filtered_object_pose
            lost = tracked is not None and motion is None
            if lost or pose is None or pose.confidence < least:
                continue
            velocity, smear = None, np.zeros(2)
            if motion is not None and shot.stamps is not None:
                velocity = motion.velocity
                squares = velocity**2 + np.diag(motion.velocity_covariance)
                skew = np.ptp(shot.stamps[[image is not None for image in shot.images]])
                smear = skew * np.sqrt(squares.reshape(2, 3).sum(axis=1))
            seen.append(Sighting(one, shot.number, pose.position, pose.rotation, velocity, smear, begins))
            begins = False
            progress(1)
    some = evenly([(one.footage, one.number) for one in seen] or every, SAMPLE)
    if another := another_shown(tracker, [next(one.images([number])) for one, number in some]):
        raise CalibrationError(another)
    return seen


LEVEL = np.radians(6.0)
"""Largest tilt of a face of an object at rest against z = 0, including the tilt of the world frame [rad]."""

FRAMES, SAME = 3, (3e-3, np.radians(2.0))
"""Consecutive frames in which an object must be at rest, and its largest motion during these [m, rad]."""


def resting(sightings: Iterable[Sighting]) -> list[Sighting]:
    """Return one sighting per place where the object may be at rest, and every still in which it is level.

    Some may show an object that is held still: callers must be robust against these.
    """
    runs: list[list[Sighting]] = []
    for one in sightings:
        level = np.abs(one.rotation[2]).max() > np.cos(LEVEL)
        if not level or not (one.velocity is None or slow(one.velocity)):
            continue
        run = [] if not runs or one.begins or one.velocity is None else runs[-1]
        if run and one.number == run[-1].number + 1 and near(one, run[0], SAME):
            run.append(one)
        else:
            runs.append([one])
    return [run[len(run) // 2] for run in runs if run[0].velocity is None or len(run) >= FRAMES]


Posed: TypeAlias = Sighting | PoseEstimate | PoseColumns
"""Something with one pose; columns have one row."""


def near(one: Posed, other: Posed, limits: tuple[float, float]) -> bool:
    """Return whether the object moved and turned by less than these limits [m, rad]; False for a NaN pose."""
    moved = np.linalg.norm(one.position - other.position)
    return bool(moved < limits[0] and so3.angle_between(one.rotation, other.rotation) < limits[1])


Moving: TypeAlias = MotionEstimate | FilteredColumns
"""Something with one pose and its velocity."""


def stays(before: Moving | None, now: Moving | None) -> bool:
    """Return whether an object is at rest: slow, and where it was before, as a new track has no velocity."""
    if before is None or now is None:
        return False
    return near(before, now, SAME) and slow(now.velocity.ravel())


APART = 8e-3, np.radians(8.0)
"""Smallest motion for which a pose counts as different [m, rad]."""

LEAST, SPREAD, TURNED = 18, 0.03, np.radians(30.0)
"""Smallest number of different poses, standard deviation of their positions over all axes together [m], and
rotation between some of them [rad]; an object that is only shifted shows the same edges."""

SMEARED = 0.3e-3, np.radians(0.3)
"""Largest motion between the images of a frame that is used [m, rad]."""

UNSEEN = "is its image right, and its tf_world_to_camera in metres and from world to camera?"
_FAR_OFF = "; cameras off by over a few mm or half a degree need a board first: tracker calibrate extrinsics"


def apart(sightings: Sequence[Sighting]) -> list[Sighting]:
    """Return the sightings whose pose differs from those of all returned before."""
    every, numbers = np.array([one.position for one in sightings]), list[int]()
    for n, one in enumerate(sightings):
        beside = np.linalg.norm(every[numbers] - one.position, axis=1) < APART[0]  # few, of thousands
        if not any(near(one, sightings[numbers[k]], APART) for k in np.flatnonzero(beside)):
            numbers.append(n)
    return [sightings[n] for n in numbers]


def different(name: str, seen: Sequence[Sighting], most: int) -> list[Sighting]:
    """Return up to `most` sightings in different poses; CalibrationError if there are too few."""
    sharp = [one for one in seen if (one.smear < SMEARED).all()]
    if not sharp:
        more = f"; in {len(seen)} more it moved between the cameras' images" if seen else ""
        raise CalibrationError(f"refine: found no frame in which {name} is surely seen{more}{_FAR_OFF}")
    chosen = apart(sharp)
    places = np.array([one.position for one in chosen])
    turns = np.array([one.rotation for one in chosen])
    turn = max(so3.angle_between(turns, one.rotation).max() for one in evenly(chosen, most))
    spread = float(np.sqrt(places.var(axis=0).sum()))
    if len(chosen) < LEAST or spread < SPREAD or turn < TURNED:
        raise CalibrationError(
            f"refine: found {len(chosen)} different poses in which {name} is seen, expected {LEAST} or more; "
            f"they spread by {1e3 * spread:.0f} mm (expected {1e3 * SPREAD:.0f}) and turn by up to "
            f"{np.degrees(turn):.0f}° (expected {np.degrees(TURNED):.0f}): move and turn it all over the "
            f"arena{_FAR_OFF}"
        )
    return evenly(chosen, most)
