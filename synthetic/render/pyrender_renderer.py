"""pyrender over EGL: OpenGL says which triangle each pixel shows, the shared shading does the rest."""

from __future__ import annotations

from synthetic.render.gl_codes import CodePainter
from synthetic.render.hits import hits_of_codes, labels_of_codes, labels_of_hits, nearness_of_hits
from synthetic.render.interface import Layers, PinholeView
from synthetic.render.light import SceneLight
from synthetic.render.surfaces import SurfaceStore
from synthetic.scene import PlatformScene


class PyrenderRenderer:
    """Renderer over OpenGL without a screen. One context, in which each mesh is stored once."""

    name = "pyrender"

    def __init__(self) -> None:
        self._painter = CodePainter()
        self._store = SurfaceStore()
        self._light = SceneLight()

    def render(self, scene: PlatformScene, view: PinholeView, *, shadows: bool = True) -> Layers:
        """What `view` shows of `scene`."""
        surfaces = self._store.of_scene(scene)
        bodies = [(n, body.mesh, body.world_from_body) for n, body in enumerate(scene.bodies)]
        hits = hits_of_codes(self._painter.paint(view, bodies), view, surfaces)
        objects = [row for row in bodies if surfaces.is_object[row[0]]]
        alone = labels_of_codes(self._painter.paint(view, objects), surfaces)
        color = self._light.shade(scene, hits, view, surfaces, shadows=shadows)
        return Layers(color, labels_of_hits(hits, surfaces), alone, nearness_of_hits(hits, view))

    def close(self) -> None:
        """Delete the OpenGL context."""
        self._painter.close()
