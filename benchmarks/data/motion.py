"""Films of fast motions, with two versions of each frame: all cameras at once, and one after the other.

The object flies between points in the arena. Its pose is known at any time, so each camera's image is
rendered at that camera's own timestamp.
"""

import dataclasses
import functools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from benchmarks.data.plan import Plan, stream
from benchmarks.data.scenes import SIZE
from benchmarks.data.store import Store, each
from synthetic.camera.rigs import default_cameras
from synthetic.camera.sensor import Sensor
from synthetic.stills import posed_scene, take
from tracker.calibration.rig import CameraRig
from tracker.conventions import FloatArray, Image
from tracker.geometry import so3
from tracker.geometry.camera import Camera
from tracker.objects.model import load_object

SPEED = 0.5
"""Typical speed of an object that is thrown or pushed hard [m/s]."""

REACH, HEIGHTS = 0.12, (0.06, 0.12)
"""Largest distance of turning points from the arena's axis, and range of their heights [m]: all cameras see
the object there, and none of its corners touches the wall or the table."""

LEAST = 0.1
"""Smallest distance between consecutive turning points [m]; less than REACH, so that one always exists."""

TURN_RATES = (0.5, 2.5)
"""Smallest and largest rate of rotation while moving [rad/s]."""

BULGE = 0.35
"""Largest height of a curved leg over its chord, relative to the chord."""

REST_SECONDS = (0.3, 0.8)
"""Shortest and longest duration of a rest [s]."""

KINDS, SHARES = ("straight", "curved", "eased", "rest"), (0.4, 0.25, 0.2, 0.15)
"""Kinds of legs and their probabilities: straight at constant speed; along a parabola; straight, starting and
ending at rest; at rest."""


@dataclass(frozen=True, eq=False)
class Leg:
    """The motion from one turning point to the next."""

    begin: float
    """Start time [s]."""
    seconds: float
    """Duration [s]."""
    start: FloatArray
    """(3,) position at the start [m]."""
    chord: FloatArray
    """(3,) vector from the start to the end [m]."""
    bulge: FloatArray
    """(3,) displacement of the path's middle from that of the chord [m]."""
    rotation: FloatArray
    """(3, 3) world_from_object at the start."""
    turn: FloatArray
    """(3,) rotation vector of the whole leg, along world axes [rad]."""
    eased: bool
    """Whether it starts and ends at rest."""

    @property
    def end(self) -> float:
        """End time [s]."""
        return self.begin + self.seconds

    def pose(self, time: float) -> tuple[FloatArray, FloatArray]:
        """Return position (3,) [m] and rotation (3, 3) at a time [s]; outside the leg, those at its ends."""
        share = min(max((time - self.begin) / self.seconds, 0.0), 1.0)
        if self.eased:
            share = share * share * (3.0 - 2.0 * share)
        position: FloatArray = self.start + share * self.chord + 4.0 * share * (1.0 - share) * self.bulge
        rotation: FloatArray = so3.exp(share * self.turn) @ self.rotation
        return position, rotation


@dataclass(frozen=True, eq=False)
class Motion:
    """Consecutive legs without gaps."""

    legs: tuple[Leg, ...]
    """The first begins with the motion."""

    def pose(self, time: float) -> tuple[FloatArray, FloatArray]:
        """Return position (3,) [m] and rotation (3, 3) at a time [s]; before and after, those of the ends."""
        ends = [leg.end for leg in self.legs]
        return self.legs[min(int(np.searchsorted(ends, time, side="right")), len(ends) - 1)].pose(time)

    def speed(self, time: float) -> float:
        """Return the speed of the object's centre [m/s] over the preceding millisecond."""
        step = 1e-3
        return float(np.linalg.norm(self.pose(time)[0] - self.pose(time - step)[0])) / step


def random_motion(rng: np.random.Generator, begin: float, seconds: float) -> Motion:
    """Draw a motion that starts at a time and lasts at least `seconds` [s]; its first leg is a rest."""
    position, rotation = _point(rng), so3.matrix_from_quaternion(rng.standard_normal(4))
    legs = [_leg(rng, "rest", begin, position, rotation)]
    while legs[-1].end < begin + seconds:
        last = legs[-1]
        kind = str(rng.choice(KINDS, p=SHARES))
        legs.append(_leg(rng, kind, last.end, *last.pose(last.end)))
    return Motion(tuple(legs))


def _leg(rng: np.random.Generator, kind: str, begin: float, start: FloatArray, rotation: FloatArray) -> Leg:
    nowhere = np.zeros(3)
    if kind == "rest":
        return Leg(begin, rng.uniform(*REST_SECONDS), start, nowhere, nowhere, rotation, nowhere, False)
    end = _point(rng)
    while np.linalg.norm(end - start) < LEAST:
        end = _point(rng)
    chord = end - start
    length = float(np.linalg.norm(chord))
    seconds = length / (SPEED * rng.uniform(0.8, 1.2))
    bulge = nowhere
    if kind == "curved":
        across = np.cross([0.0, 0.0, 1.0], chord)
        # Bulge towards the arena's axis, where there is room.
        side = -np.sign(across @ (start + end)) or 1.0
        bulge = side * rng.uniform(0.3, 1.0) * BULGE * length * across / np.linalg.norm(across)
    axis = rng.standard_normal(3)
    turn = seconds * rng.uniform(*TURN_RATES) * axis / np.linalg.norm(axis)
    return Leg(begin, seconds, start, chord, bulge, rotation, turn, kind == "eased")


def _point(rng: np.random.Generator) -> FloatArray:
    angle, radius = rng.uniform(0, 2 * np.pi), REACH * np.sqrt(rng.random())
    return np.array([radius * np.cos(angle), radius * np.sin(angle), rng.uniform(*HEIGHTS)])


RATE = 10.0
"""Frame rate [Hz]."""

SKEW = 0.010
"""Time between the first and the last camera's image in a skewed frame [s]; the others are evenly spaced.
Which camera is first changes from frame to frame, since the cameras are not synchronised."""

AHEAD = 0.050
"""Prediction horizon [s]."""

SLOW = 0.1
"""Speed below which an object does not count as moving [m/s]."""

BEFORE = 0.2
"""Time by which a film's motion begins before its first frame [s]."""

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
    latest: FloatArray
    """(3, 4) rotation and position [m] of the object, world_from_object, at the latest timestamp."""
    ahead: FloatArray
    """(3, 4) pose AHEAD after the latest timestamp."""
    moving: bool
    """Whether the object is faster than SLOW at the latest timestamp."""

    @property
    def timestamp(self) -> float:
        """The latest timestamp [s]."""
        return float(self.stamps.max())


def rig() -> CameraRig:
    """Return the true cameras of these films."""
    return CameraRig(default_cameras(SIZE))


def motion_store(object_name: str, plan: Plan) -> Store[MotionFrame]:
    """Return the frames of an object's films; frame k of film f has the number f · FRAMES + k."""
    own = stream(plan.seed, "motion", object_name)
    make = functools.partial(each, _frames, object_name, own)
    return Store(f"motion, {object_name}", MotionFrame, make, (__name__,), own, plan)


def film_motion(seed: int, film: int) -> Motion:
    """Return the motion in a film, from before its first frame until after its last."""
    return random_motion(np.random.default_rng([seed, film]), -BEFORE, FRAMES / RATE + BEFORE + AHEAD)


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
        latest, ahead = _pose(motion, time), _pose(motion, time + AHEAD)
        return MotionFrame(stamps, together, skewed, latest, ahead, motion.speed(time) > SLOW)

    return make


def _pose(motion: Motion, time: float) -> FloatArray:
    position, rotation = motion.pose(time)
    return np.column_stack([rotation, position])
