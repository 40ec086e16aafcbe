"""The platform's interface for any source, so that the platform's control loops run unchanged.

Names and meanings are those of the platform's observations, front ends and log reader. There are two
differences, described only here:

- The platform has an object pose in every observation. Here, position and orientation are NaN if the object
  was not found, so that no one uses them by mistake, and the confidence is 0.
- A time index counts sets of images. The platform's robot counts its own steps at 1 kHz, and its
  `get_camera_observation(t)` returns the newest observation at step t; here it returns the newest one of all.
"""

from __future__ import annotations

import os
import threading
from collections import deque
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tracker.calibration.rig import CameraRig
from tracker.checks import is_whole
from tracker.conventions import FloatArray, Image
from tracker.errors import LiveError, shown
from tracker.live.live import PATIENCE, Live, check_arguments
from tracker.live.moment import ImageSource, Moment
from tracker.logs import open_log
from tracker.logs.frame import RecordedPose
from tracker.logs.pictures import from_bayer
from tracker.pipeline import ObjectTracker
from tracker.pose.result import PoseEstimate

HISTORY = 30
"""Number of observations kept, with their images: three seconds at 10 Hz."""


class CameraObservation(NamedTuple):
    """One camera's image."""

    image: Image | None
    """Image (H, W, 3) uint8 BGR, or raw Bayer pixels (H, W) on request; None: the camera gave none."""
    timestamp: float
    """Timestamp of the image [s]."""


@dataclass(frozen=True, eq=False)
class ObjectPose:
    """The object's pose."""

    position: FloatArray
    """(3,) [m]; NaN if the object was not found."""
    orientation: FloatArray
    """Quaternion (4,) x, y, z, w; NaN if the object was not found."""
    confidence: float
    """Probability of being within 5 mm and 5° of the truth; 0 if the object was not found."""

    @classmethod
    def of(cls, pose: PoseEstimate | RecordedPose | None) -> ObjectPose:
        """Return a pose in the platform's form."""
        if pose is None:
            return cls(np.full(3, np.nan), np.full(4, np.nan), 0.0)
        return cls(pose.position, pose.orientation, float(pose.confidence))


class CameraObjectObservation(NamedTuple):
    """Images of all cameras, and the object's pose in them."""

    cameras: tuple[CameraObservation, ...]
    """One observation per camera, in the order of the rig."""
    object_pose: ObjectPose
    """The pose measured in these images."""
    filtered_object_pose: ObjectPose
    """The pose fused with earlier measurements."""


class Frontend(AbstractContextManager["Frontend"]):
    """Tracks an object in the images of a source, with the platform's interface; a context manager.

    Args:
        source: the source of images, which is closed at the end.
        tracker: the tracker that finds the object.
        raw: whether observations hold raw Bayer pixels, as in newer versions of the platform; only for
            sources that provide them.
        history: number of observations kept.

    Raises:
        LiveError: raised by all methods that return an observation if it will not come or is no longer kept.
    """

    def __init__(
        self, source: ImageSource, tracker: ObjectTracker, *, raw: bool = False, history: int = HISTORY
    ) -> None:
        check_arguments(tracker, history)
        self._rig, self._raw = tracker.rig, raw
        self._changed = threading.Condition()
        self._kept: deque[tuple[int, float, CameraObjectObservation]] = deque(maxlen=history)
        self._fault: str | None = None
        self._live = Live(source, tracker, listeners=[self._hear])

    def __exit__(self, *_: object) -> None:
        self.shutdown()

    @property
    def live(self) -> Live:
        """The underlying `Live`, for functions that the platform does not have, such as `at`."""
        return self._live

    def shutdown(self) -> None:
        """Stop tracking and close the source."""
        self._live.close()

    def get_sensor_info(self) -> CameraRig:
        """Return the cameras with their calibration."""
        return self._rig

    def has_observations(self) -> bool:
        """Return whether there is any observation yet."""
        return bool(self._kept)

    def get_current_timeindex(self) -> int:
        """Return the time index of the newest observation; wait if there is none yet."""
        return self._waited()[-1][0]

    def get_oldest_timeindex(self) -> int:
        """Return the time index of the oldest observation kept; wait if there is none yet."""
        return self._waited()[0][0]

    def wait_until_timeindex(self, t: int) -> None:
        """Wait until there is an observation of time index t."""
        self._waited(t)

    def get_observation(self, t: int) -> CameraObjectObservation:
        """Return the observation of time index t; wait if it is still to come."""
        return self._at(t)[2]

    def get_timestamp_ms(self, t: int) -> float:
        """Return the timestamp of the latest image of time index t [ms]."""
        return 1e3 * self._at(t)[1]

    def get_latest_observation(self) -> CameraObjectObservation:
        """Return the newest observation; wait if there is none yet; LiveError once the source has failed."""
        number, _, newest = self._waited()[-1]
        if self._live.error is not None:
            self._waited(number + 1)  # raises an error with the reason
        return newest

    def get_camera_observation(self, t: int | None = None) -> CameraObjectObservation:
        """Return the newest observation, regardless of the robot's step t."""
        return self.get_latest_observation()

    def get_pose(self, t: int) -> ObjectPose:
        """Return the filtered pose of time index t."""
        return self.get_observation(t).filtered_object_pose

    def get_current_pose(self) -> ObjectPose:
        """Return the newest filtered pose."""
        return self.get_latest_observation().filtered_object_pose

    def _hear(self, moment: Moment) -> None:
        taken = moment.taken
        images = taken.raw if self._raw else taken.images
        if images is None:
            images = (None,) * len(taken.images)
            if any(image is not None for image in taken.images):
                self._fault = "found images in colour, expected raw Bayer pixels"
                return
        cameras = tuple(map(CameraObservation, images, taken.stamps))
        poses = map(ObjectPose.of, (moment.object_pose, moment.filtered_object_pose))
        with self._changed:
            self._kept.append((moment.sequence, moment.timestamp, CameraObjectObservation(cameras, *poses)))
            self._changed.notify_all()

    def _at(self, t: int) -> tuple[int, float, CameraObjectObservation]:
        kept = {one[0]: one for one in self._waited(t)}
        if t not in kept:
            raise LiveError(f"observation {t}: not kept any more, the oldest is {min(kept)}")
        return kept[t]

    def _waited(self, t: int = 0) -> list[tuple[int, float, CameraObjectObservation]]:
        """Wait for time index t or later, then return all observations kept."""
        if not is_whole(t):
            raise LiveError(f"t: found {shown(t)}, expected a whole number")
        with self._changed:
            while not (self._kept and self._kept[-1][0] >= t):
                reason = self._fault or self._live.error
                if isinstance(reason, (KeyboardInterrupt, SystemExit)):
                    raise reason
                if reason is not None or not self._live.running:
                    reason = reason or "the source has ended"
                    raise LiveError(f"observation {t}: will not come: {reason}")
                self._changed.wait(PATIENCE)
            return list(self._kept)


class LogReader:
    """A recording, read wholly into memory; for long ones, `tracker.open_log` holds one frame at a time."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.read_file(path)

    def read_file(self, path: str | os.PathLike[str]) -> None:
        """Replace this recording with another; LogError if it cannot be read."""
        self.data: list[CameraObjectObservation] = []  # with the poses of the recorder
        self.timestamps: list[float] = []  # of the observations [ms]
        with open_log(path) as log:
            for frame in log:
                images = frame.raw or frame.images
                cameras = tuple(map(CameraObservation, images, frame.camera_timestamps.tolist()))
                poses = map(ObjectPose.of, (frame.recorded_pose, frame.recorded_filtered_pose))
                self.data.append(CameraObjectObservation(cameras, *poses))
                self.timestamps.append(1e3 * frame.timestamp)


def convert_image(image: Image) -> Image:
    """Convert raw Bayer pixels (H, W), red at even rows and columns, to BGR (H, W, 3); keep colour images."""
    return from_bayer(image) if image.ndim == 2 else image
