"""The cameras as they are for a scene or a film: each a unit of its own, and what they have in common.

They run free and are grabbed one after another, and exposure takes time.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from synthetic.camera.compression import GROUP, Compression
from synthetic.camera.miscalibration import Calibrated, exactly, miscalibrated
from synthetic.camera.optics import Coma, Focus, Fringes
from synthetic.camera.response import Drift, FixedPattern, Response, Sharpening
from synthetic.camera.sensor import CameraSettings, Sensor, mosaicked
from synthetic.effects import Effects, stream
from synthetic.scene import PlatformScene
from tracker.calibration.rig import CameraRig
from tracker.conventions import FloatArray, Image
from tracker.geometry import so3
from tracker.geometry.camera import Camera

PERIOD = 0.010
"""Of cameras that run free [s]: what is grabbed is up to so much older than what is newest."""

EXPOSURES = 0.0015, 0.010
"""Least and greatest time of exposure [s]; the platform's is 1.5 ms."""

IN_ROOM_LIGHT = 0.004, 0.015
"""Least and greatest time of exposure of a camera without the platform's lamps [s]."""

STEP, MOST = 1.0, 6
"""Motion [px] between two of an exposure's scenes, which the lens blurs away, and most of such scenes."""

STILL = 0.02
"""A motion of less [px] is none."""

_RADIUS = 0.05
"""Of what turns, from its origin [m]."""


@dataclass(frozen=True, eq=False)
class Timing:
    """How the cameras of a film are timed."""

    exposure: float
    """[s]"""
    phases: FloatArray
    """(cameras,) of their periods when the film begins, 0 to 1."""
    drifts: FloatArray
    """(cameras,) by how much each clock is fast."""

    @classmethod
    def sample(cls, rng: np.random.Generator, cameras: int) -> Timing:
        """Exposure by whatever light there is; clocks as quartzes are."""
        exposure = np.exp(rng.uniform(*np.log(EXPOSURES)))
        return cls(float(exposure), rng.uniform(0.0, 1.0, cameras), rng.normal(0.0, 1e-4, cameras))

    @classmethod
    def together(cls, rng: np.random.Generator, cameras: int) -> Timing:
        """Exposure alone: all cameras at once."""
        return cls(float(np.exp(rng.uniform(*np.log(IN_ROOM_LIGHT)))), np.zeros(cameras), np.zeros(cameras))

    def stamps(self, time: float) -> FloatArray:
        """(cameras,) the middle of each camera's exposure [s]; the latest is `time`."""
        ages = PERIOD * ((self.phases + self.drifts * time / PERIOD) % 1.0)
        result: FloatArray = time - (ages - ages.min())
        return result

    def shutter(self, stamp: float, motion: float) -> list[float]:
        """Times [s] at which scenes are to be averaged, where things move by `motion` [px] meanwhile."""
        count = min(MOST, 1 + round(motion / STEP))
        times = stamp + self.exposure * ((np.arange(count) + 0.5) / count - 0.5)
        return [float(time) for time in times]


def motion_px(first: PlatformScene, second: PlatformScene, focal: float, distance: float = 0.45) -> float:
    """By how many pixels anything moves at most, seen from so far [m] through a focal length [px]."""
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
    """One camera and what is its own; None: it has no such effect."""

    camera: Camera
    """As it truly is."""
    sensor: Sensor
    """What it makes of light."""
    settings: CameraSettings
    """How it is set and lit."""
    focus: Focus | None = None
    """Blur in place of the sensor's."""
    fringes: Fringes | None = None
    """How colours come apart."""
    skewed_psf: Coma | None = None
    """How points are drawn out."""
    sharpening: Sharpening | None = None
    """What it does to its pictures."""
    fixed_pattern: FixedPattern | None = None
    """How its pixels differ."""
    drift: Drift | None = None
    """How its exposure changes."""

    def at(self, time: float) -> Unit:
        """The camera as it is at a time [s]."""
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
"""Effects that are fields of `Unit`, in their order."""


def units_of(
    rig: CameraRig, sensor: Sensor, rng: np.random.Generator, effects: Effects, seed: int, number: int
) -> tuple[Unit, ...]:
    """The units of a rig.

    Args:
        rig: the cameras.
        sensor: what they have in common.
        rng: draws the settings.
        effects: which imperfections they have, each drawn from a stream of its own.
        seed: of the effects' streams.
        number: of the scene or film, for the same.
    """

    def drawn(name: str, sample: Callable[[np.random.Generator], Drawn]) -> list[Drawn | None]:
        if not getattr(effects, name):
            return [None] * len(rig)
        own = stream(name, seed, number)
        return [sample(own) for _ in rig]

    settings = [sensor.settings(rng) for _ in rig]
    responses = drawn("response", Response.sample)
    sensors = [sensor if response is None else response.of(sensor) for response in responses]
    if effects.focus:
        sensors = [dataclasses.replace(own, psf_sigma=0.0) for own in sensors]
    own = [drawn(name, sample) for name, sample in _OWN.items()]
    return tuple(Unit(*parts) for parts in zip(rig, sensors, settings, *own, strict=True))


@dataclass(frozen=True, eq=False)
class Crew:
    """The cameras of a scene or film."""

    units: tuple[Unit, ...]
    """Each camera, in the simulation's world."""
    calibrated: Calibrated
    """The same in the calibrated world, and the stated cameras."""
    timing: Timing | None = None
    """When their pictures are taken; None: all at once and in no time."""
    compression: Compression | None = None
    """What recording does to them; None: nothing."""

    @property
    def group(self) -> int:
        """Number of pictures of a film from one that needs none of those before to the next."""
        return GROUP if self.compression is not None and self.compression.kind == "h264" else 1

    def recorded(self, taken: Sequence[tuple[Image, ...]], *, raw: bool) -> tuple[Image, ...]:
        """The last of the pictures of all cameras as a recording gives them back.

        Args:
            taken: (H, W, 3) BGR of each camera, from the beginning of the last group on.
            raw: they are recorded and given back as mosaics (H, W).
        """
        images = taken[-1]
        if self.compression is not None:
            own = self.compression
            if raw and own.kind == "jpeg":
                own = dataclasses.replace(own, kind="mosaic")
            images = tuple(own.applied(pictures) for pictures in zip(*taken, strict=True))
        return tuple(mosaicked(image) for image in images) if raw else images


def crew_of(
    rig: CameraRig,
    sensor: Sensor,
    rng: np.random.Generator,
    effects: Effects,
    seed: int,
    number: int,
    *,
    film: bool,
) -> Crew:
    """The cameras of scene or film `number`; arguments as of `units_of`. Only films are grabbed in turn."""
    timing = None
    if effects.timing and film:
        timing = Timing.sample(stream("timing", seed, number), len(rig))
    elif effects.motion_blur:
        timing = Timing.together(stream("motion_blur", seed, number), len(rig))
    return Crew(
        units_of(rig, sensor, rng, effects, seed, number),
        miscalibrated(rig, stream("calibration", seed, number)) if effects.calibration else exactly(rig),
        timing,
        Compression.sample(stream("compression", seed, number)) if effects.compression else None,
    )
