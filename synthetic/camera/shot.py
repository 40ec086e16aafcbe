"""One camera's image of a scene: render a wide view, distort it by the lens, expose."""

import dataclasses
import functools
from collections.abc import Sequence

import numpy as np

from synthetic.camera.lens import Lens
from synthetic.camera.sensor import Sensor
from synthetic.camera.units import Unit
from synthetic.render.raster import Layers
from synthetic.render.renderer import label_maps, render
from synthetic.scene import PlatformScene
from tracker.conventions import Array, Image

SENSOR_HEIGHT = 540
"""Height of the images that the platform's cameras take [px]; `Sensor.sample` is measured at it."""


@dataclasses.dataclass(frozen=True)
class Quality:
    """How much work is spent on an image."""

    name: str
    """Name in the ground truth and on the command line."""
    full: bool
    """Whether the sensor's grid has SENSOR_HEIGHT rows, and a smaller image is halved from it; else those of
    the output image."""
    points: int
    """Points per pixel of the sensor's grid, along each axis."""
    shadows: bool
    """Whether lamps cast shadows."""

    def sensor(self, rng: np.random.Generator, path: str | None, height: int) -> Sensor:
        """Draw a kind of camera for images of `height` [px]; figures are scaled for half the resolution."""
        sensor = Sensor.sample(rng, path)
        if self.full or height >= SENSOR_HEIGHT:
            return sensor
        # One pixel collects the charge of four: less noise, and half the blur in pixels twice as wide.
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
        Quality("fast", full=False, points=2, shadows=False),
        Quality("default", full=True, points=2, shadows=True),
        Quality("best", full=True, points=4, shadows=True),
    )
}


@dataclasses.dataclass(frozen=True, eq=False)
class CameraShot:
    """One camera's image, and the ground truth of its pixels."""

    image: Image
    """(H, W, 3) uint8 BGR."""
    labels: Image
    """(H, W) uint8 label map of what is visible."""
    alone: Image
    """(H, W) uint8 label map of the objects alone, without the robot."""


def shoot(
    scenes: Sequence[PlatformScene],
    unit: Unit,
    quality: Quality,
    noise: np.random.Generator,
    middle: PlatformScene | None = None,
) -> CameraShot:
    """Take an image with one camera of scenes at equal intervals while its shutter is open.

    The light is their mean, the label maps are those of `middle`, the scene in the middle of the exposure;
    None: one of `scenes`, whose number is odd. `noise` draws nothing but the noise.
    """
    camera = unit.camera
    halved = quality.full and camera.height < SENSOR_HEIGHT
    factor = 2 if halved else 1
    # An image at full resolution is already sampled finely.
    points = 1 if not quality.full and camera.height > 400 else quality.points
    lens = Lens(camera.resized(camera.width * factor, camera.height * factor), points)
    views = [render(scene, lens.view, shadows=quality.shadows) for scene in scenes]
    light = sum((_light(layers, lens, unit) for layers in views[1:]), _light(views[0], lens, unit))
    if len(views) % 2 == 0 and middle is not None:
        labels, alone = label_maps(middle, lens.view)
    else:
        labels, alone = views[len(views) // 2].labels, views[len(views) // 2].alone
    # The fine camera's lattice of points is also the camera's own, so both share one view.
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
        labels=np.asarray(coarse.to_camera(labels, "label"), dtype=np.uint8),
        alone=np.asarray(coarse.to_camera(alone, "label"), dtype=np.uint8),
    )


def _light(layers: Layers, lens: Lens, unit: Unit) -> Array:
    """Return the light (H, W, 3) on the sensor's grid, after the effects of the lens."""
    light = lens.to_camera(layers.color, "mean", None if unit.fringes is None else unit.fringes.stretch)
    if unit.focus is not None:
        light = unit.focus.blurred(light, lens.to_camera(layers.nearness, "mean"))
    return light if unit.skewed_psf is None else unit.skewed_psf.applied(light)
