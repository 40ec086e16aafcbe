"""A painter says which triangle each pixel shows; the shared shading does the rest."""

from __future__ import annotations

from typing import Protocol

from synthetic.render.hits import hits_of_codes, labels_of_codes, labels_of_hits, nearness_of_hits, shared
from synthetic.render.interface import Layers, PinholeView
from synthetic.render.light import SceneLight
from synthetic.render.surfaces import SurfaceStore
from synthetic.scene import Mesh, PlatformScene
from tracker.conventions import Array, FloatArray


class Painter(Protocol):
    """Draws the numbers of triangles."""

    def paint(self, view: PinholeView, bodies: list[tuple[int, Mesh, FloatArray]]) -> Array:
        """Codes (h, w) as in `surfaces` of bodies, each with its number, mesh and world_from_body (4, 4)."""
        ...

    def close(self) -> None:
        """Give back what it holds outside of Python."""
        ...


class CodeRenderer:
    """Renderer over a painter."""

    def __init__(self, name: str, painter: Painter) -> None:
        self.name = name
        self._painter = painter
        self._store = SurfaceStore()
        self._light = SceneLight()

    def render(self, scene: PlatformScene, view: PinholeView, *, shadows: bool = True) -> Layers:
        """What `view` shows of `scene`."""
        surfaces = self._store.of_scene(scene)
        bodies = [(n, body.mesh, body.world_from_body) for n, body in enumerate(scene.bodies)]
        codes = self._painter.paint(view, bodies)
        objects = [row for row in bodies if surfaces.is_object[row[0]]]
        alone = labels_of_codes(self._painter.paint(view, objects), surfaces)
        at, stands = shared(codes, surfaces, view.block) if view.block > 1 else (None, None)
        hits = hits_of_codes(codes, view, surfaces, at)
        color = self._light.shade(scene, hits, view, surfaces, shadows=shadows)
        labels, nearness = labels_of_hits(hits, surfaces), nearness_of_hits(hits, view)
        if stands is not None:
            color, labels, nearness = color[0][stands], labels[0][stands], nearness[0][stands]
        return Layers(color, labels, alone, nearness)

    def close(self) -> None:
        """Close the painter."""
        self._painter.close()
