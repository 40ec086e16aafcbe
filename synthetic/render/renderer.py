"""The renderer: from a scene and a pinhole view to linear light and exact label maps.

A rasteriser finds each pixel's triangle; light is computed where the pixel's ray hits it. It needs neither
OpenGL nor a screen. The tests compare its label maps with pyrender's.
"""

import functools

import numpy as np

from synthetic.render.hits import hits_of_codes, labels_of_codes, shared
from synthetic.render.raster import Layers, PinholeView, paint
from synthetic.render.shading import add_bounced, shade
from synthetic.render.shadows import Shadows, add_contact, shadows_of, take_shadows
from synthetic.render.surfaces import surfaces_of
from synthetic.scene import PlatformScene
from tracker.conventions import Array, Image

KEPT = 7
"""Number of scenes whose surfaces and shadows are cached: those of one exposure, shared by all cameras."""


NAME = "raster"
"""The renderer's name in the ground truth."""

_surfaces = functools.lru_cache(KEPT)(surfaces_of)


def render(scene: PlatformScene, view: PinholeView, *, shadows: bool = True) -> Layers:
    """Render `view` of `scene`; without `shadows` nothing blocks light, which is faster.

    The same scene and view give the same bits.
    """
    surfaces = _surfaces(scene)
    (codes, nearness), (alone, _) = _painted(scene, view)
    at, stands = shared(codes, surfaces, view.block) if view.block > 1 else (None, None)
    hits = hits_of_codes(codes, view, surfaces, at)
    reach = np.ones((*hits.body.shape, 1 + len(scene.lighting.lamps)), np.float32)
    if shadows:
        take_shadows(reach, hits, view, _shadows(scene), scene.lighting)
        add_contact(reach, hits, scene)
    color = shade(hits, view, surfaces, scene.lighting, reach)
    if scene.patches is not None:
        add_bounced(color, scene, scene.patches, hits, surfaces)
    if stands is not None:
        color = color[0][stands]
    return Layers(color, labels_of_codes(codes, surfaces), labels_of_codes(alone, surfaces), nearness)


def label_maps(scene: PlatformScene, view: PinholeView) -> tuple[Image, Image]:
    """Return `labels` and `alone` of the scene's `Layers`, without the light."""
    surfaces = _surfaces(scene)
    labels, alone = (labels_of_codes(codes, surfaces) for codes, _ in _painted(scene, view))
    return labels, alone


def _painted(scene: PlatformScene, view: PinholeView) -> tuple[tuple[Array, Array], ...]:
    """Return codes and 1 / depth of all bodies, and of the objects alone."""
    is_object = _surfaces(scene).is_object
    bodies = [(n, body.mesh, body.world_from_body) for n, body in enumerate(scene.bodies)]
    return paint(view, bodies), paint(view, [row for row in bodies if is_object[row[0]]])


@functools.lru_cache(KEPT)
def _shadows(scene: PlatformScene) -> Shadows:
    return shadows_of(_surfaces(scene), scene.lighting)
