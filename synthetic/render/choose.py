"""Which renderer a process uses."""

from __future__ import annotations

import os

from synthetic.render.code_renderer import CodeRenderer
from synthetic.render.interface import Renderer, RendererError
from synthetic.render.raster_codes import RasterPainter

RENDERERS = ("auto", "pyrender", "raster")
"""Names that `choose_renderer` knows."""

_live: dict[int, Renderer] = {}
"""The renderer of a process, by the process's number: a second OpenGL context in a process is where drivers
fail, and so is one that a child inherits."""


def choose_renderer(name: str = "auto") -> Renderer:
    """The renderer of that name; `auto` is pyrender over EGL where it works, else raster.

    A process keeps one renderer: asking again returns it, asking for another one closes it first.

    Raises:
        RendererError: there is none of this name, or it does not work on this machine.
    """
    if name not in RENDERERS:
        raise RendererError(f"renderer: found {name!r}, expected one of {', '.join(RENDERERS)}")
    renderer = _live.get(os.getpid())
    if renderer is None or name not in ("auto", renderer.name):
        close_renderer()
        renderer = _live[os.getpid()] = _make(name)
    return renderer


def close_renderer() -> None:
    """Close the renderer of this process, if there is one."""
    renderer = _live.pop(os.getpid(), None)
    if renderer is not None:
        renderer.close()


def _make(name: str) -> Renderer:
    if name in ("auto", "pyrender"):
        try:
            # Imported here: it needs packages and libraries of its own, and the other works without them.
            from synthetic.render.gl_codes import CodePainter

            return CodeRenderer("pyrender", CodePainter())
        except Exception as error:
            # What a missing driver raises is anything from ImportError to AttributeError.
            if name == "pyrender":
                raise RendererError(f"pyrender over EGL does not work here: {error!r}") from error
    return CodeRenderer("raster", RasterPainter())
