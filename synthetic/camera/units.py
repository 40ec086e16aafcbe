"""The cameras of a rig as they are for a while: each with its own sensor, settings and optics."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from synthetic.camera.focus import Focus
from synthetic.camera.fringes import Fringes
from synthetic.camera.response import Response
from synthetic.camera.sensor import CameraSettings, Sensor
from synthetic.camera.sharpening import Sharpening
from synthetic.effects import Effects, stream
from tracker.calibration.rig import CameraRig
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
    sharpening: Sharpening | None = None
    """What it does to its pictures."""


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
    optics = (
        drawn("focus", Focus.sample),
        drawn("fringes", Fringes.sample),
        drawn("sharpening", Sharpening.sample),
    )
    return tuple(Unit(*parts) for parts in zip(rig, sensors, settings, *optics, strict=True))
