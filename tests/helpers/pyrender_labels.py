"""What pyrender shows of a scene: labels and depth by another rasteriser, OpenGL's, to check ours against."""

from __future__ import annotations

import os

import numpy as np

from synthetic.render.raster import PinholeView
from synthetic.scene import PlatformScene
from tests.helpers.needs import lack
from tracker.conventions import FloatArray, Image

_NEAR_M, _FAR_M = 0.02, 5.0


def labels_and_depth(scene: PlatformScene, view: PinholeView) -> tuple[Image, FloatArray]:
    """Labels (h, w) of visible surfaces, and their depth (h, w) [m], 0 where nothing is.

    The test that calls it is skipped where pyrender over EGL does not work: its release 0.1.45 relies on a
    screen by default, and on NumPy 1. PYOPENGL_PLATFORM and PYGLET_HEADLESS stay set, since it reads them
    again later.
    """
    os.environ["PYOPENGL_PLATFORM"], os.environ["PYGLET_HEADLESS"] = "egl", "1"
    lacking = not hasattr(np, "infty")  # NumPy 1's name of infinity, in default arguments of pyrender
    if lacking:
        setattr(np, "infty", np.inf)  # noqa: B010
    try:
        import pyrender

        canvas = pyrender.OffscreenRenderer(view.width, view.height)
    except Exception as error:
        # What a missing driver raises is anything from ImportError to AttributeError.
        lack("platform", f"pyrender over EGL does not work here: {error!r}")
    finally:
        if lacking:
            delattr(np, "infty")
    world, colors = pyrender.Scene(bg_color=np.zeros(4)), {}
    for body in scene.bodies:
        for group in np.unique(body.mesh.groups):
            triangles = np.asarray(body.mesh.triangles)[np.asarray(body.mesh.groups) == group]
            part = pyrender.Primitive(np.asarray(body.mesh.vertices), indices=triangles, mode=4)
            node = world.add(pyrender.Mesh([part]), pose=body.world_from_body)
            colors[node] = np.full(3, body.labels[group])
    # Pixel centres are half a pixel further there, and its cameras look backwards, with y upwards.
    camera = pyrender.IntrinsicsCamera(view.fx, view.fy, view.cx + 0.5, view.cy + 0.5, _NEAR_M, _FAR_M)
    world.add(camera, pose=np.linalg.inv(view.camera_from_world) @ np.diag([1.0, -1.0, -1.0, 1.0]))
    try:
        flags = pyrender.RenderFlags.SEG | pyrender.RenderFlags.SKIP_CULL_FACES
        picture, depth = canvas.render(world, flags, colors)
    finally:
        canvas.delete()
    return picture[..., 0].copy(), np.asarray(depth, np.float64)
