"""One camera's picture of a scene: render wide, bend by the lens, expose."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence

import numpy as np

from synthetic.camera.lens import Lens
from synthetic.camera.sensor import Sensor
from synthetic.camera.units import Unit
from synthetic.render.raster import Layers
from synthetic.render.renderer import Renderer
from synthetic.scene import PlatformScene
from tracker.conventions import Array, Image

SENSOR_HEIGHT = 540
"""Height [px] at which the platform's cameras take pictures, and for which `Sensor.sample` is measured."""


@dataclasses.dataclass(frozen=True)
class Quality:
    """How much work goes into a picture."""

    name: str
    """For the ground truth and the command line."""
    sensor_height: int | None
    """The light falls on so many rows [px], then the picture is halved if need be; None: as given out."""
    points: int
    """Points per pixel of the sensor's grid, along each axis."""
    shadows: bool
    """Whether lamps cast shadows."""

    def sensor(self, rng: np.random.Generator, path: str | None = None) -> Sensor:
        """A kind of camera drawn from `rng`; where it works at half the resolution its figures are scaled."""
        sensor = Sensor.sample(rng, path)
        if self.sensor_height is not None:
            return sensor
        # One pixel has the charge of four: less noise, and a blur of half as many, wider pixels.
        return dataclasses.replace(
            sensor,
            psf_sigma=float(np.hypot(0.5 * sensor.psf_sigma, 0.3)),
            full_well=2.0 * sensor.full_well,
            read_noise=0.7 * sensor.read_noise,
            binned=True,
        )


QUALITIES = {
    quality.name: quality
    for quality in (
        Quality("fast", sensor_height=None, points=2, shadows=False),
        Quality("default", sensor_height=SENSOR_HEIGHT, points=2, shadows=True),
        Quality("best", sensor_height=SENSOR_HEIGHT, points=4, shadows=True),
    )
}


@dataclasses.dataclass(frozen=True, eq=False)
class CameraShot:
    """What one camera gives, and the truth of each of its pixels."""

    image: Image
    """(H, W, 3) uint8 BGR."""
    labels: Image
    """(H, W) uint8 of what is visible."""
    alone: Image
    """(H, W) uint8 of what would be visible without robot."""


def shoot(
    renderer: Renderer,
    scenes: Sequence[PlatformScene],
    unit: Unit,
    quality: Quality,
    noise: np.random.Generator,
) -> CameraShot:
    """The picture that a camera takes.

    Args:
        renderer: renders `scenes`.
        scenes: what there is while the shutter is open, at equal intervals: the light is their mean, the
            labels are those of the middle one.
        unit: the camera.
        quality: how much work goes into the picture.
        noise: draws the noise and nothing else.
    """
    camera = unit.camera
    halved = quality.sensor_height is not None and quality.sensor_height > camera.height
    factor = 2 if halved else 1
    # A fine picture is already sampled finely.
    points = max(1, quality.points // 2) if quality.sensor_height is None and camera.height > 400 else 0
    points = points or quality.points
    lens = Lens(camera.resized(camera.width * factor, camera.height * factor), points)
    views = [renderer.render(scene, lens.view, shadows=quality.shadows) for scene in scenes]
    light = sum((_light(layers, lens, unit) for layers in views[1:]), _light(views[0], lens, unit))
    middle = views[len(views) // 2]
    # The lattice of the fine camera's points is that of the camera itself: the view is the same.
    coarse = Lens(camera, points * factor)
    pattern = unit.fixed_pattern
    return CameraShot(
        image=unit.sensor.expose(
            light if len(views) == 1 else light / len(views),
            noise,
            unit.settings,
            halved=halved,
            pattern=None
            if pattern is None
            else functools.partial(pattern.applied, binned=unit.sensor.binned),
            finish=None if unit.sharpening is None else unit.sharpening.applied,
        ),
        labels=np.asarray(coarse.to_camera(middle.labels, "label"), dtype=np.uint8),
        alone=np.asarray(coarse.to_camera(middle.alone, "label"), dtype=np.uint8),
    )


def _light(layers: Layers, lens: Lens, unit: Unit) -> Array:
    """Light (H, W, 3) on the sensor's grid, as far as the lens decides it."""
    light = lens.to_camera(layers.color, "mean", None if unit.fringes is None else unit.fringes.stretch)
    if unit.focus is not None:
        light = unit.focus.blurred(light, lens.to_camera(layers.nearness, "mean"))
    return light if unit.skewed_psf is None else unit.skewed_psf.applied(light)
