"""The cameras as they are for a scene or a film: each a unit of its own, and what they have in common."""

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
from synthetic.camera.timing import Timing
from synthetic.effects import Effects, stream
from tracker.calibration.rig import CameraRig
from tracker.conventions import Image
from tracker.geometry.camera import Camera

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
    """The same in the calibrated world, and what is said of them."""
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
            taken: (H, W, 3) BGR of each camera, from the beginning of the last one's group on.
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
