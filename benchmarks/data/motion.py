"""Films of fast motions, with two versions of each frame: all cameras at once, and one after the other.

The motion is known at any time, so each camera's image is rendered at that camera's own timestamp.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.data.paths import Motion, random_motion
from benchmarks.data.scenes import SIZE
from benchmarks.data.seeds import stream
from benchmarks.data.store import CACHE, Store, each
from synthetic.camera.rigs import default_cameras
from synthetic.camera.sensor import Sensor
from synthetic.stills import posed_scene, take
from tracker.calibration.rig import CameraRig
from tracker.conventions import FloatArray, Image
from tracker.geometry.camera import Camera
from tracker.objects.model import load_object

RATE = 10.0
"""Frame rate [Hz]."""

SKEW = 0.010
"""Time between the first and the last camera's image in a skewed frame [s]; the others are evenly spaced.
Which camera is first changes from frame to frame, since the cameras are not synchronised."""

AHEAD = 0.050
"""Prediction horizon [s]."""

SLOW = 0.1
"""Speed below which an object does not count as moving [m/s]."""

STEADY = 0.2
"""Time that a steadily moving object has spent on its current leg [s]; it also stays on it for AHEAD."""

FRAMES = 100
"""Number of frames of each film."""


@dataclass(frozen=True, eq=False)
class MotionFrame:
    """Both versions of a frame, and the ground truth."""

    stamps: FloatArray
    """(cameras,) timestamps of the skewed images [s]."""
    together: tuple[Image, ...]
    """(H, W, 3) uint8 BGR of each camera, all at the latest of these timestamps."""
    skewed: tuple[Image, ...]
    """(H, W, 3) uint8 BGR of each camera at its own timestamp."""
    at_stamps: FloatArray
    """(cameras, 3, 4) rotation and position [m] of the object, world_from_object, at each timestamp."""
    latest: FloatArray
    """(3, 4) pose at the latest timestamp."""
    ahead: FloatArray
    """(3, 4) pose AHEAD after the latest timestamp."""
    moving: bool
    """Whether the object is faster than SLOW at the latest timestamp."""
    steady: bool
    """Whether it is moving steadily."""

    @property
    def timestamp(self) -> float:
        """The latest timestamp [s]."""
        return float(self.stamps.max())


def rig() -> CameraRig:
    """Return the true cameras of these films."""
    return CameraRig(default_cameras(SIZE))


def motion_store(object_name: str, seed: int, workers: int = 2, cache: Path = CACHE) -> Store[MotionFrame]:
    """Return the frames of an object's films; frame k of film f has the number f · FRAMES + k.

    Args:
        object_name: name of the object.
        seed: seed of the benchmark.
        workers: number of processes that render missing frames.
        cache: folder of rendered frames.
    """
    own = stream(seed, "motion", object_name)
    make = functools.partial(each, _frames, object_name, own)
    name = f"motion, {object_name}"
    return Store(name, MotionFrame, make, (__name__,), own, workers=workers, cache=cache)


def film_motion(seed: int, film: int) -> Motion:
    """Return the motion in a film, from before its first frame until after its last."""
    return random_motion(np.random.default_rng([seed, film]), -STEADY, FRAMES / RATE + STEADY + AHEAD)


def delays(rng: np.random.Generator, cameras: int) -> FloatArray:
    """Draw (cameras,) the age of each camera's image relative to the latest one, at most SKEW [s]."""
    result: FloatArray = rng.permutation(np.linspace(0.0, SKEW, cameras))
    return result


def _frames(object_name: str, seed: int) -> Callable[[int], MotionFrame]:
    model, cameras = load_object(object_name), rig()
    # A camera's settings stay constant in a film, but `take` would draw them for every image.
    sensor = dataclasses.replace(Sensor.realistic(), exposure=(1.0, 1.0), white_balance=0.0, ramp=0.0)

    def make(index: int) -> MotionFrame:
        film, number = divmod(index, FRAMES)
        motion = film_motion(seed, film)
        rng = np.random.default_rng([seed, film, 2, number])
        time = number / RATE
        stamps = time - delays(rng, len(cameras))

        def picture(camera: Camera, stamp: float) -> Image:
            # Without fingers, which would have to move aside; colours and light are those of the film.
            scene = posed_scene(model, motion.pose(stamp), np.random.default_rng([seed, film, 1]))
            (image,) = take(scene, [camera], sensor, rng).images
            return image

        together = tuple(picture(camera, time) for camera in cameras)
        skewed = tuple(
            picture(camera, stamp) if stamp < time else same
            for camera, stamp, same in zip(cameras, stamps.tolist(), together, strict=True)
        )
        leg, moving = motion.leg(time), motion.speed(time) > SLOW
        return MotionFrame(
            stamps,
            together,
            skewed,
            np.stack([_pose(motion, stamp) for stamp in stamps.tolist()]),
            _pose(motion, time),
            _pose(motion, time + AHEAD),
            moving,
            moving and leg.begin <= time - STEADY and leg.end >= time + AHEAD,
        )

    return make


def _pose(motion: Motion, time: float) -> FloatArray:
    position, rotation = motion.pose(time)
    return np.column_stack([rotation, position])
