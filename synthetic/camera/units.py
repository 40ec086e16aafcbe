"""The cameras of a scene or film: each a unit with its own effects, and the effects that they share.

They run free and are grabbed one after another, and exposures are not instantaneous.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Container, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from synthetic.camera.compression import GROUP, Compression
from synthetic.camera.miscalibration import Calibrated, miscalibrated
from synthetic.camera.optics import Coma, Focus, Fringes
from synthetic.camera.response import Drift, FixedPattern, Response, Sharpening
from synthetic.camera.sensor import CameraSettings, Sensor, mosaicked
from synthetic.effects import stream
from synthetic.scene import PlatformScene
from tracker.calibration.rig import CameraRig
from tracker.conventions import FloatArray, Image
from tracker.geometry import so3
from tracker.geometry.camera import Camera

PERIOD = 0.010
"""Period of free-running cameras [s]: a grabbed image is up to this much older than the newest one."""

EXPOSURES = 0.0015, 0.010
"""Shortest and longest exposure time [s]; the platform's is 1.5 ms."""

IN_ROOM_LIGHT = 0.004, 0.015
"""Shortest and longest exposure time of a camera without the platform's lamps [s]."""

STEP, MOST = 1.0, 6
"""Motion between consecutive scenes of an exposure [px], which the lens's blur hides; most scenes allowed."""

STILL = 0.02
"""Motion that is ignored if smaller [px]."""

_RADIUS = 0.05
"""Radius at which a body's rotation is converted to a displacement [m]."""


@dataclass(frozen=True, eq=False)
class Timing:
    """Exposure and clocks of the cameras of a film."""

    exposure: float
    """Exposure time [s]."""
    phases: FloatArray
    """(cameras,) phases within their periods when the film begins, 0 to 1."""
    drifts: FloatArray
    """(cameras,) relative rates by which the clocks are fast."""

    @classmethod
    def sample(cls, rng: np.random.Generator, cameras: int) -> Timing:
        """Draw an exposure for any lighting, and clocks with the drift of quartz crystals."""
        exposure = np.exp(rng.uniform(*np.log(EXPOSURES)))
        return cls(float(exposure), rng.uniform(0.0, 1.0, cameras), rng.normal(0.0, 1e-4, cameras))

    @classmethod
    def together(cls, rng: np.random.Generator, cameras: int) -> Timing:
        """Draw an exposure only: all cameras expose at once."""
        return cls(float(np.exp(rng.uniform(*np.log(IN_ROOM_LIGHT)))), np.zeros(cameras), np.zeros(cameras))

    def stamps(self, time: float) -> FloatArray:
        """Return (cameras,) the middle of each camera's exposure [s]; the latest is `time`."""
        ages = PERIOD * ((self.phases + self.drifts * time / PERIOD) % 1.0)
        result: FloatArray = time - (ages - ages.min())
        return result

    def shutter(self, stamp: float, motion: float) -> list[float]:
        """Return times [s] of the scenes to average, for a motion of `motion` [px] during the exposure."""
        count = min(MOST, 1 + round(motion / STEP))
        times = stamp + self.exposure * ((np.arange(count) + 0.5) / count - 0.5)
        return [float(time) for time in times]


def motion_px(first: PlatformScene, second: PlatformScene, focal: float, distance: float = 0.45) -> float:
    """Return the largest motion [px] of any body, seen from a distance [m] with a focal length [px]."""
    most = 0.0
    for a, b in zip(first.bodies, second.bodies, strict=True):
        if a.world_from_body is b.world_from_body or np.array_equal(a.world_from_body, b.world_from_body):
            continue
        shift = float(np.linalg.norm(a.world_from_body[:3, 3] - b.world_from_body[:3, 3]))
        turn = float(so3.angle_between(a.world_from_body[:3, :3], b.world_from_body[:3, :3]))
        most = max(most, shift + _RADIUS * turn)
    return most * focal / distance


Drawn = TypeVar("Drawn")


@dataclass(frozen=True, eq=False)
class Unit:
    """One camera and its own effects; None: without that effect."""

    camera: Camera
    """The true camera."""
    sensor: Sensor
    settings: CameraSettings
    focus: Focus | None = None
    """Replaces the sensor's blur."""
    fringes: Fringes | None = None
    skewed_psf: Coma | None = None
    sharpening: Sharpening | None = None
    fixed_pattern: FixedPattern | None = None
    drift: Drift | None = None

    def at(self, time: float) -> Unit:
        """Return the camera as it is at a time [s]."""
        if self.drift is None:
            return self
        gains = self.settings.gains * self.drift.at(time)
        return dataclasses.replace(self, settings=dataclasses.replace(self.settings, gains=gains))


_OWN: dict[str, Callable[[np.random.Generator], object]] = {
    "focus": Focus.sample,
    "fringes": Fringes.sample,
    "skewed_psf": Coma.sample,
    "sharpening": Sharpening.sample,
    "fixed_pattern": FixedPattern.sample,
    "drift": Drift.sample,
}
"""Effects that are fields of `Unit`, in the order of its fields."""


def units_of(
    rig: CameraRig, sensor: Sensor, rng: np.random.Generator, effects: Container[str], seed: int, number: int
) -> tuple[Unit, ...]:
    """Draw the units of a rig, which share a sensor; `rng` draws their settings.

    Each effect has a stream of its own, from the seed and the number of the scene or film.
    """

    def drawn(name: str, sample: Callable[[np.random.Generator], Drawn]) -> list[Drawn | None]:
        if name not in effects:
            return [None] * len(rig)
        own = stream(name, seed, number)
        return [sample(own) for _ in rig]

    settings = [sensor.settings(rng) for _ in rig]
    responses = drawn("response", Response.sample)
    sensors = [sensor if response is None else response.of(sensor) for response in responses]
    if "focus" in effects:
        sensors = [dataclasses.replace(own, psf_sigma=0.0) for own in sensors]
    own = [drawn(name, sample) for name, sample in _OWN.items()]
    return tuple(Unit(*parts) for parts in zip(rig, sensors, settings, *own, strict=True))


@dataclass(frozen=True, eq=False)
class Crew:
    """The cameras of a scene or film."""

    units: tuple[Unit, ...]
    """The cameras, in the simulation's world."""
    calibrated: Calibrated
    """The true cameras in the calibrated world, and the stated ones."""
    timing: Timing | None = None
    """When their images are taken; None: all at once and instantaneously."""
    compression: Compression | None = None
    """Compression of the recording; None: none."""

    @property
    def group(self) -> int:
        """Interval between the film's key frames [images]."""
        return GROUP if self.compression is not None and self.compression.kind == "h264" else 1

    def recorded(self, taken: Sequence[tuple[Image, ...]], *, raw: bool) -> tuple[Image, ...]:
        """Return the last images of all cameras as they come out of a recording; if `raw`, mosaics (H, W).

        `taken` has images (H, W, 3) BGR of each camera, from the last key frame on.
        """
        images = taken[-1]
        if self.compression is not None:
            cameras = zip(*taken, strict=True)
            images = tuple(self.compression.applied(pictures, raw=raw) for pictures in cameras)
        return tuple(mosaicked(image) for image in images) if raw else images


def crew_of(
    rig: CameraRig,
    sensor: Sensor,
    rng: np.random.Generator,
    effects: Container[str],
    seed: int,
    number: int,
    *,
    film: bool,
) -> Crew:
    """Draw the cameras of scene or film `number`, see `units_of`; only films are grabbed in turn."""
    timing = None
    if "timing" in effects and film:
        timing = Timing.sample(stream("timing", seed, number), len(rig))
    elif "motion_blur" in effects:
        timing = Timing.together(stream("motion_blur", seed, number), len(rig))
    calibrated = Calibrated(rig, rig)
    if "calibration" in effects:
        calibrated = miscalibrated(rig, stream("calibration", seed, number))
    return Crew(
        units_of(rig, sensor, rng, effects, seed, number),
        calibrated,
        timing,
        Compression.sample(stream("compression", seed, number)) if "compression" in effects else None,
    )
