"""Films of fast motions, each frame taken twice: by all cameras at once, and by one after the other.

Each camera's picture is of that camera's own time, of a motion known at any time.
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
"""Frames per second [Hz]."""

SKEW = 0.010
"""Between the first and the last camera's picture of a skewed frame [s]; the others are spread evenly, and
who is first changes from frame to frame, since the cameras run free."""

AHEAD = 0.050
"""By which a pose is to be predicted [s]."""

SLOW = 0.1
"""A slower object does not count as moving [m/s]."""

STEADY = 0.2
"""An object that has not turned back for so long [s], nor does within AHEAD, moves steadily."""

FRAMES = 100
"""Of each film."""


@dataclass(frozen=True, eq=False)
class MotionFrame:
    """A frame taken twice, and the truth."""

    stamps: FloatArray
    """(cameras,) when the skewed pictures were taken [s]."""
    together: tuple[Image, ...]
    """(H, W, 3) uint8 BGR of each camera, all taken at the latest of these stamps."""
    skewed: tuple[Image, ...]
    """The same, each taken at its own stamp."""
    at_stamps: FloatArray
    """(cameras, 3, 4) rotation and position [m] of the object, world from object, at each stamp."""
    latest: FloatArray
    """(3, 4) the same at the latest stamp."""
    ahead: FloatArray
    """(3, 4) the same AHEAD of the latest stamp."""
    moving: bool
    """Whether the object is faster than SLOW at the latest stamp."""
    steady: bool
    """Whether it moves, and steadily."""

    @property
    def timestamp(self) -> float:
        """The latest stamp [s]."""
        return float(self.stamps.max())


def rig() -> CameraRig:
    """The cameras of these films, exactly."""
    return CameraRig(default_cameras(SIZE))


def motion_store(object_name: str, seed: int, workers: int = 2, cache: Path = CACHE) -> Store[MotionFrame]:
    """The frames of an object's films; frame k of film f has the number f · FRAMES + k.

    Args:
        object_name: name of the object.
        seed: of all that is drawn.
        workers: number of processes that render what is missing.
        cache: where frames are kept.
    """
    own = stream(seed, "motion", object_name)
    make = functools.partial(each, _frames, object_name, own)
    name = f"motion, {object_name}"
    return Store(name, MotionFrame, make, (__name__,), own, workers=workers, cache=cache)


def film_motion(seed: int, film: int) -> Motion:
    """The motion of a film: from before its first frame until after its last."""
    return random_motion(np.random.default_rng([seed, film]), -STEADY, FRAMES / RATE + STEADY + AHEAD)


def delays(rng: np.random.Generator, cameras: int) -> FloatArray:
    """(cameras,) by which each camera's picture is older than the latest one, at most SKEW [s]."""
    result: FloatArray = rng.permutation(np.linspace(0.0, SKEW, cameras))
    return result


def _frames(object_name: str, seed: int) -> Callable[[int], MotionFrame]:
    model, cameras = load_object(object_name), rig()
    # A camera's settings stay while it records, but they would be drawn for every picture.
    sensor = dataclasses.replace(Sensor.realistic(), exposure=(1.0, 1.0), white_balance=0.0, ramp=0.0)

    def make(index: int) -> MotionFrame:
        film, number = divmod(index, FRAMES)
        motion = film_motion(seed, film)
        rng = np.random.default_rng([seed, film, 2, number])
        time = number / RATE
        stamps = time - delays(rng, len(cameras))

        def picture(camera: Camera, stamp: float) -> Image:
            # Without fingers, which would have to make way; colours and light are those of the film.
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
