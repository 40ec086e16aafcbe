"""Which triangle each pixel shows, drawn by OpenGL through pyrender's context, buffers and shaders.

pyrender's own passes shade with tone curves of their own, smooth edges by four samples, and set every uniform
once per node. Here one shader writes the number of body and triangle as a flat colour, and nothing else.
"""

from __future__ import annotations

import ctypes
import os
from collections import OrderedDict
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import numpy.typing as npt

from synthetic.render.interface import PinholeView
from synthetic.scene import Mesh
from tracker.conventions import Array, FloatArray

_NEAR_M, _FAR_M = 0.02, 5.0
_KEPT_MESHES = 256

_INFINITY = "infty"
"""NumPy 1's name of infinity, which NumPy 2 lacks and default arguments of pyrender use."""

Codes = npt.NDArray[np.uint32]
"""(h, w) as in `surfaces`: (body + 1) << 24 | triangle."""


def import_pyrender() -> ModuleType:
    """Import pyrender 0.1.45, which relies on a screen unless told otherwise, and on NumPy 1.

    PYOPENGL_PLATFORM and PYGLET_HEADLESS stay set, since pyrender reads them again later.
    """
    os.environ["PYOPENGL_PLATFORM"] = "egl"
    os.environ["PYGLET_HEADLESS"] = "1"
    lacking = not hasattr(np, _INFINITY)
    if lacking:
        setattr(np, _INFINITY, np.inf)
    try:
        import pyrender
    finally:
        if lacking:
            delattr(np, _INFINITY)
    module: ModuleType = pyrender
    return module


class CodePainter:
    """One OpenGL context with the meshes that it has been given, and a frame buffer that grows."""

    def __init__(self) -> None:
        pyrender = import_pyrender()
        from OpenGL import GL
        from pyrender.shader_program import ShaderProgramCache

        self._pyrender, self._gl = pyrender, GL
        self._offscreen = pyrender.OffscreenRenderer(16, 16)
        folder = Path(__file__).parent / "shaders"
        self._program = ShaderProgramCache(str(folder)).get_program("codes.vert", "codes.frag")
        self._program._add_to_context()
        self._locations = {
            key: GL.glGetUniformLocation(self._program._program_id, key) for key in ("clip_from_body", "body")
        }
        self._primitives: OrderedDict[str, Any] = OrderedDict()
        self._frame: list[int] = []
        self._frame_size = (0, 0)

    def close(self) -> None:
        """Delete the context and all in it."""
        if self._offscreen is None:
            return
        self._offscreen._platform.make_current()
        for primitive in self._primitives.values():
            primitive.delete()
        self._primitives.clear()
        self._delete_frame()
        self._program.delete()
        self._offscreen.delete()
        self._offscreen = None

    def paint(self, view: PinholeView, bodies: list[tuple[int, Mesh, FloatArray]]) -> Codes:
        """Codes (h, w) of bodies, each with its number, mesh and world_from_body (4, 4)."""
        gl = self._gl
        self._offscreen._platform.make_current()
        self._use_frame(view.width, view.height)
        gl.glViewport(0, 0, view.width, view.height)
        for switch in (gl.GL_BLEND, gl.GL_DITHER, gl.GL_MULTISAMPLE, gl.GL_CULL_FACE):
            gl.glDisable(switch)
        gl.glEnable(gl.GL_DEPTH_TEST)
        gl.glDepthMask(gl.GL_TRUE)
        gl.glDepthFunc(gl.GL_LESS)
        gl.glClearColor(0.0, 0.0, 0.0, 0.0)
        gl.glClear(gl.GL_COLOR_BUFFER_BIT | gl.GL_DEPTH_BUFFER_BIT)
        self._program._bind()
        clip_from_world = _clip_from_camera(view) @ view.camera_from_world
        for number, mesh, world_from_body in bodies:
            self._draw(number, mesh, clip_from_world @ world_from_body)
        gl.glBindVertexArray(0)
        self._program._unbind()
        gl.glPixelStorei(gl.GL_PACK_ALIGNMENT, 4)
        data = gl.glReadPixels(0, 0, view.width, view.height, gl.GL_RGBA, gl.GL_UNSIGNED_BYTE)
        return np.frombuffer(data, "<u4").reshape(view.height, view.width)

    def _draw(self, number: int, mesh: Mesh, clip_from_body: FloatArray) -> None:
        gl, primitive = self._gl, self._primitive(mesh)
        matrix = np.ascontiguousarray(clip_from_body, np.float32)
        gl.glUniformMatrix4fv(self._locations["clip_from_body"], 1, gl.GL_TRUE, matrix)
        gl.glUniform1f(self._locations["body"], (number + 1) / 255.0)
        gl.glBindVertexArray(primitive._vaid)
        count = primitive.indices.size
        gl.glDrawElements(gl.GL_TRIANGLES, count, gl.GL_UNSIGNED_INT, ctypes.c_void_p(0))

    def _primitive(self, mesh: Mesh) -> Any:
        """The mesh in the context's memory, under its key."""
        primitive = self._primitives.get(mesh.key)
        if primitive is None:
            primitive = self._pyrender.Primitive(
                positions=np.asarray(mesh.vertices, np.float32), indices=np.asarray(mesh.triangles, np.uint32)
            )
            primitive._add_to_context()
            self._primitives[mesh.key] = primitive
            if len(self._primitives) > _KEPT_MESHES:
                self._primitives.popitem(last=False)[1].delete()
        self._primitives.move_to_end(mesh.key)
        return primitive

    def _use_frame(self, width: int, height: int) -> None:
        gl = self._gl
        if self._frame_size[0] < width or self._frame_size[1] < height:
            self._delete_frame()
            width, height = max(width, self._frame_size[0]), max(height, self._frame_size[1])
            color, depth = (int(n) for n in gl.glGenRenderbuffers(2))
            for buffer, kind in ((color, gl.GL_RGBA8), (depth, gl.GL_DEPTH_COMPONENT32F)):
                gl.glBindRenderbuffer(gl.GL_RENDERBUFFER, buffer)
                gl.glRenderbufferStorage(gl.GL_RENDERBUFFER, kind, width, height)
            frame = int(gl.glGenFramebuffers(1))
            gl.glBindFramebuffer(gl.GL_FRAMEBUFFER, frame)
            for slot, buffer in ((gl.GL_COLOR_ATTACHMENT0, color), (gl.GL_DEPTH_ATTACHMENT, depth)):
                gl.glFramebufferRenderbuffer(gl.GL_FRAMEBUFFER, slot, gl.GL_RENDERBUFFER, buffer)
            self._frame, self._frame_size = [frame, color, depth], (width, height)
        gl.glBindFramebuffer(gl.GL_FRAMEBUFFER, self._frame[0])

    def _delete_frame(self) -> None:
        if self._frame:
            self._gl.glDeleteFramebuffers(1, self._frame[:1])
            self._gl.glDeleteRenderbuffers(2, self._frame[1:])
            self._frame = []


def _clip_from_camera(view: PinholeView) -> Array:
    """(4, 4) from OpenCV's camera axes to OpenGL's clip space, with the image's first row at the bottom.

    OpenGL's pixel (i, j) is the square from i to i + 1, and its centre is at i + ½: hence half a pixel more
    than where pixel centres are at whole numbers. OpenGL's rows count upwards; since the picture is drawn
    upside down, they are read back in order.
    """
    w, h = view.width, view.height
    depth, product = _FAR_M - _NEAR_M, 2 * _FAR_M * _NEAR_M
    return np.array(
        [
            [2 * view.fx / w, 0.0, 2 * (view.cx + 0.5) / w - 1, 0.0],
            [0.0, 2 * view.fy / h, 2 * (view.cy + 0.5) / h - 1, 0.0],
            [0.0, 0.0, (_FAR_M + _NEAR_M) / depth, -product / depth],
            [0.0, 0.0, 1.0, 0.0],
        ]
    )
