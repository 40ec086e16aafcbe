"""One frame of a recording: its timestamps, and the object's pose as recorded."""

import dataclasses
import math
from collections.abc import Container, Iterable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from tracker.checks import Frozen, freeze, one_stamp, shown_in
from tracker.conventions import Array, FloatArray, Image
from tracker.errors import LogError

MAX_DISTANCE = 2e4
"""Largest valid coordinate of a recorded position [m]: cameras may be this far from the world's origin."""

MAX_CONFIDENCE = 2.0
"""Largest valid recorded confidence: nominally 1, but a sum with hand-tuned weights may exceed it."""

MAX_GAP = 3600.0
"""Longest valid time between two frames of one recording [s]; a job on the platform lasts minutes."""

EARLIEST = -MAX_GAP
"""Smallest valid timestamp [s]: a simulated clock may start below zero, but a time since the epoch with a
damaged sign is far below."""

EPOCH = 1e9
"""Times since the epoch are later [s]: the year 2001. Simulated clocks and those of cameras begin near 0."""

UNKNOWN: FloatArray = np.empty(0)
"""Stamps that follow from the images' timestamps."""

CLOCKS = 1.0
"""Cameras whose timestamps differ by more [s] have different clocks."""

_APART = 1e-3  # [s] between frames without a timestamp at the beginning of a recording
_ZERO_NORM = 1e-6  # shorter quaternions were never set: their memory held about zero
NORM_TOLERANCE = 0.01
"""Largest deviation of a recorded quaternion's length from 1."""


@dataclass(frozen=True, eq=False)
class RecordedPose(Frozen):
    """A pose estimated by the recorder's tracker. Arrays are read-only.

    Attributes:
        position: (3,) the object's centre in the world [m].
        orientation: (4,) unit quaternion x, y, z, w of world_from_object.
        confidence: confidence of the recorder's tracker, nominally 0 to 1; not a probability.
    """

    position: FloatArray
    orientation: FloatArray
    confidence: float

    def __post_init__(self) -> None:
        freeze(self, "position", np.array(self.position, dtype=np.float64).reshape(3))
        freeze(self, "orientation", np.array(self.orientation, dtype=np.float64).reshape(4))


@dataclass(frozen=True, eq=False)
class LogFrame:
    """The images of all cameras at one moment.

    Attributes:
        index: number of the frame in its recording, from 0.
        timestamp: timestamp of the frame [s], since the epoch in recordings of the platform. If a driver
            error left the frame empty: between its neighbours' timestamps, or NaN if the frame was read
            alone.
        camera_timestamps: (C,) timestamps of the cameras' images [s]; NaN for a missing image.
        images: (H, W, 3) uint8 BGR image of each camera in order; None for a missing image.
        recorded_pose: the object's pose as the recorder's tracker measured it, or None.
        recorded_filtered_pose: the same after its filter, or None.
        raw: (H, W) uint8 raw Bayer pixels of each camera, red at even rows and columns, None for a missing
            image; None if the recording has colour images.
        stamps: (C,) timestamps for `ObjectTracker.update` [s]: the images', or the frame's for a missing one,
            or for all if the cameras' clocks differ. As you iterate over a recording, they never go back.
    """

    index: int
    timestamp: float
    camera_timestamps: FloatArray
    images: tuple[Image | None, ...] = field(repr=False)
    recorded_pose: RecordedPose | None
    recorded_filtered_pose: RecordedPose | None
    raw: tuple[Image | None, ...] | None = field(default=None, repr=False)
    stamps: FloatArray = field(default_factory=lambda: UNKNOWN, repr=False)

    def __post_init__(self) -> None:
        if self.stamps is UNKNOWN:
            given = np.asarray(self.camera_timestamps)
            known = ~np.isnan(given)
            if known.any() and np.ptp(given[known]) > CLOCKS:
                known[:] = False
            freeze(self, "stamps", np.where(known, given, self.timestamp))

    @property
    def newest(self) -> float:
        """Timestamp of the newest image [s], the time of a pose found in the frame; the frame's without any.

        A black image counts only if there are no others.

        The platform's recorder stamps a frame when its own tracker is done, up to 0.1 s after its images.
        """
        return float(max(self.stamps[shown_in(self.images)], default=self.stamps.max()))


def recorded_frame(
    index: int,
    images: Sequence[Image | None],
    raw: Iterable[Image | None] | None,
    camera_stamps: FloatArray,
    stamp: float | None,
    poses: Iterable[Array],
    *,
    where: str,
) -> LogFrame:
    """Make a frame from values of the platform's recorder; LogError, naming `where`, if they are invalid.

    After a driver error the recorder appends an empty frame, whose stamps are 0: it has no images, and if its
    `stamp` is 0, too, its timestamp is NaN. The recorder leaves the memory of such images as it was: they are
    black, or what was there before, such as an older image.
    `camera_stamps`: (C,) [s]; `stamp`: the frame's [ms], or None; `poses`: records (8,), up to two: the
    measured and the filtered pose.
    """
    for number, value in enumerate(camera_stamps, start=1):
        checked_stamp(value, what=f"{where}, camera number {number}")
    late = stamp is not None and stamp / 1000 > EPOCH  # so its cameras' clocks are not at 0
    if not camera_stamps.any() and (late or not any(image is not None and image.any() for image in images)):
        none = np.full(len(images), np.nan)
        known = checked_stamp(stamp / 1000, what=where) if stamp else np.nan
        return LogFrame(index, known, none, (None,) * len(images), None, None)
    seconds = float(np.mean(camera_stamps)) if stamp is None else checked_stamp(stamp / 1000, what=where)
    named = zip(("pose", "filtered pose"), poses, strict=False)
    found = [pose_from_record(numbers, what=f"{where}, {what}") for what, numbers in named]
    measured, filtered = [*found, None, None][:2]
    mosaics = None if raw is None else tuple(raw)
    return LogFrame(index, seconds, camera_stamps, tuple(images), measured, filtered, mosaics)


def pose_from_record(values: Array, *, what: str) -> RecordedPose | None:
    """Return the pose of a record (8,), or None if the recorder had none; LogError if it is invalid.

    The record is position [m], quaternion x, y, z, w, confidence. Confidence 0, an all-zero quaternion or
    any NaN mean that there is no pose.
    """
    position, orientation, confidence = values[:3], values[3:7], float(values[7])
    # Any value may be NaN: for a rotation of zero, the predecessor of this tracker divided by its angle.
    if not confidence > 0 or np.isnan(values).any():
        return None
    with np.errstate(over="ignore"):
        norm = float(np.linalg.norm(orientation))
    if norm < _ZERO_NORM:
        return None
    if not abs(norm - 1) <= NORM_TOLERANCE:
        raise LogError(f"{what}: found a quaternion of length {norm:.6g}, expected 1, or 0 for no pose")
    if not np.abs(position).max() <= MAX_DISTANCE:
        found = ", ".join(f"{value:.4g}" for value in position)
        raise LogError(f"{what}: found the position ({found}) m, expected at most {MAX_DISTANCE:g} m")
    if not confidence <= MAX_CONFIDENCE:
        raise LogError(f"{what}: found the confidence {confidence:.4g}, expected 0 to 1")
    return RecordedPose(position, orientation / norm, confidence)


def checked_stamp(value: object, *, what: str) -> float:
    """Return a valid timestamp [s]; LogError otherwise."""
    stamp = one_stamp(value, f"{what}: stamp", LogError)
    if stamp < EARLIEST:
        raise LogError(f"{what}: found the stamp {stamp:.6g} s, expected at least {EARLIEST:g} s")
    return stamp


MOST_SET_BACK = 60.0
"""Longest time by which a clock may be set back and still be waited for [s]."""


class WentBack(LogError):
    """A timestamp is earlier than one before it, by up to MOST_SET_BACK."""


class StampOrder:
    """Checks that timestamps neither go backwards nor jump by hours from one frame to the next.

    Equal timestamps are valid: a recorder that is faster than the cameras repeats observations.
    """

    def __init__(self, *, gaps: bool) -> None:
        """Args: gaps: whether any time may pass between frames."""
        self._gap = np.inf if gaps else MAX_GAP
        self._last: FloatArray = np.array(np.nan)
        self._index = 0

    def fault(self, index: int, timestamp: float, cameras: FloatArray, what: str) -> LogError | None:
        """Return the error if a frame does not follow the previous one; else None, and it is remembered."""
        stamps = np.array([timestamp, *cameras])
        steps = np.nan_to_num(stamps - self._last)
        worst = int(np.argmax(np.abs(np.where(steps < 0, np.inf, steps))))
        if steps[worst] < 0 or steps[worst] > self._gap:
            kind = WentBack if -MOST_SET_BACK <= steps[worst] < 0 else LogError
            way = "back" if steps[worst] < 0 else "forward"
            whose = "the frame's stamp" if worst == 0 else f"the stamp of camera number {worst}"
            return kind(
                f"{what}: {whose} goes {way} by {abs(steps[worst]):.6g} s since frame {self._index}, "
                f"expected 0 to {self._gap:g} s"
            )
        # NaN stays for a camera without any image yet, so that any timestamp may follow.
        self._last = np.where(np.isnan(stamps), self._last, stamps)
        self._index = index
        return None

    @property
    def camera_timestamps(self) -> FloatArray:
        """(C,) timestamps of each camera's latest image [s]; a single NaN before the first frame."""
        return self._last[1:] if self._last.ndim else self._last


def with_stamps(frames: Iterable[LogFrame], starts: Container[int] = ()) -> Iterator[LogFrame]:
    """Yield the frames, with interpolated timestamps for those that have none, and with stamps in order.

    starts: numbers of the frames that start an episode, where timestamps may go back.
    """
    last, behind = -math.inf, 0.0
    for frame in _interpolated(frames):
        last = -math.inf if frame.index in starts else last
        shown = any(image is not None for image in frame.images)
        moment = frame.newest
        if shown:
            behind = frame.timestamp - moment
        else:
            moment -= behind
        if not shown or moment < last:
            # If a camera that leads by more than a period misses an image, the newest is older than the last.
            moment = max(moment, math.nextafter(last, math.inf) if shown else last)
            frame = dataclasses.replace(frame, stamps=np.full(len(frame.images), moment))
        last = moment
        yield frame


def _interpolated(frames: Iterable[LogFrame]) -> Iterator[LogFrame]:
    """Yield the frames, with interpolated timestamps for those that have none."""
    waiting: list[LogFrame] = []
    last: float | None = None
    usual = _APART
    for frame in frames:
        if np.isnan(frame.timestamp):
            waiting.append(frame)
            continue
        # The first images may be older than their frame says.
        after = min(frame.timestamp, frame.newest) if last is None else frame.timestamp
        yield from _between(waiting, last, after, usual)
        if last is not None and not waiting and frame.timestamp > last:
            usual = frame.timestamp - last
        waiting, last = [], frame.timestamp
        yield frame
    yield from _between(waiting, last, None, usual)


def _between(
    frames: Sequence[LogFrame], before: float | None, after: float | None, usual: float
) -> Iterator[LogFrame]:
    count = len(frames) + 1
    if before is None:
        before = 0.0 if after is None else after - count * usual
    step = usual if after is None else (after - before) / count
    for number, frame in enumerate(frames, start=1):
        yield dataclasses.replace(frame, timestamp=before + number * step, stamps=UNKNOWN)
