"""Shading with the shadow maps of one scene, made once for all of its cameras."""

from __future__ import annotations

from synthetic.render.bounced import add_bounced
from synthetic.render.hits import Hits
from synthetic.render.interface import PinholeView
from synthetic.render.reach import everything, reach_of
from synthetic.render.shading import shade
from synthetic.render.shadows import Shadows, shadows_of
from synthetic.render.surfaces import Surfaces
from synthetic.scene import PlatformScene
from tracker.conventions import Array


class SceneLight:
    """Keeps the shadow maps of the scene asked for last."""

    def __init__(self) -> None:
        self._last: tuple[PlatformScene, Shadows] | None = None

    def shade(
        self, scene: PlatformScene, hits: Hits, view: PinholeView, surfaces: Surfaces, *, shadows: bool
    ) -> Array:
        """Linear BGR light (h, w, 3) float32 of what was hit."""
        lighting = scene.lighting
        reach = everything()
        if shadows:
            reach = reach_of(hits, view, self._maps(scene, surfaces), lighting)
        color = shade(hits, view, surfaces, lighting, reach)
        if scene.patches is not None:
            add_bounced(color, scene, scene.patches, hits, surfaces)
        return color

    def _maps(self, scene: PlatformScene, surfaces: Surfaces) -> Shadows:
        if self._last is None or self._last[0] is not scene:
            self._last = scene, shadows_of(surfaces, scene.lighting)
        return self._last[1]
