"""Print how many triplets per second each renderer makes of random scenes of the platform, in one process.

Rendering and the way back through the lens are timed; drawing the scenes, the sensor and files are not.
"""

from __future__ import annotations

import time

import click
import numpy as np

from synthetic.platform import Platform
from synthetic.render.interface import RENDERERS, RendererError, choose_renderer, close_renderer
from synthetic.render.lens import lens_of
from synthetic.scene import PlatformScene
from synthetic.scenes import random_scene
from synthetic.simple_rig import default_cameras
from tracker.geometry.camera import Camera


def triplets_per_second(
    name: str, scenes: list[PlatformScene], cameras: tuple[Camera, ...], supersampling: int, *, shadows: bool
) -> float:
    """Mean over all scenes but the first, which compiles, uploads and fills tables."""
    renderer = choose_renderer(name)
    start = 0.0
    for number, scene in enumerate(scenes):
        if number == 1:
            start = time.perf_counter()
        for camera in cameras:
            lens = lens_of(camera, supersampling)
            layers = renderer.render(scene, lens.view, shadows=shadows)
            lens.to_camera(layers.color, "mean")
            lens.to_camera(layers.labels, "label")
            lens.to_camera(layers.alone, "label")
    return (len(scenes) - 1) / (time.perf_counter() - start)


@click.command()
@click.option("--object", "object_name", default="cube_v2", show_default=True)
@click.option("--scenes", "count", default=10, show_default=True, help="Scenes per line.")
@click.option("--width", default=270, show_default=True, help="Width and height of the images [px].")
def main(object_name: str, count: int, width: int) -> None:
    """Time all renderers at one to three points per pixel and axis, without and with shadows."""
    with Platform(object_name) as platform:
        scenes = [random_scene(platform, np.random.default_rng(seed)) for seed in range(count + 1)]
    click.echo(f"{object_name}, {width} px, {count} scenes: triplets/s")
    for name in RENDERERS[1:]:
        for supersampling in (1, 2, 3):
            for shadows in (False, True):
                try:
                    speed = triplets_per_second(
                        name, scenes, default_cameras(width), supersampling, shadows=shadows
                    )
                except RendererError as error:
                    click.echo(f"{name:9s} {error}")
                    break
                click.echo(f"{name:9s} {supersampling}×{supersampling}  shadows {shadows!s:5s}  {speed:6.2f}")
    close_renderer()


if __name__ == "__main__":
    main()
