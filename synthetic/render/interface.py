"""What a renderer is: a scene and a pinhole view in, linear light and exact labels out."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from synthetic.scene import PlatformScene
from tracker.conventions import FloatArray, Image
from tracker.errors import TrackerError


class RendererError(TrackerError):
    """A renderer cannot be had on this machine, or cannot render what it was given."""


@dataclass(frozen=True, eq=False)
class PinholeView:
    """A camera without distortion: u = fx X/Z + cx, v = fy Y/Z + cy, pixel centres at whole numbers."""

    width: int
    """[px]."""
    height: int
    """[px]."""
    fx: float
    """[px]."""
    fy: float
    """[px]."""
    cx: float
    """[px]."""
    cy: float
    """[px]."""
    camera_from_world: FloatArray
    """(4, 4) [m]; OpenCV's axes: x to the right, y down, z forward."""


@dataclass(frozen=True, eq=False)
class Layers:
    """What a view shows, one value per pixel: that of the point that the pixel's central ray meets."""

    color: npt.NDArray[np.float32]
    """(h, w, 3) linear BGR light: reflectance × irradiance, may exceed 1."""
    labels: Image
    """(h, w) uint8 label of the visible surface; 0 for what is no object."""
    alone: Image
    """(h, w) uint8 labels if there were nothing but the objects, as the base of visible fractions."""


class Renderer(Protocol):
    """Renders scenes; same scene and view, same bits."""

    name: str
    """Stands in the ground truth: `pyrender` or `tiny`."""

    def render(self, scene: PlatformScene, view: PinholeView, *, shadows: bool = True) -> Layers:
        """What `view` shows of `scene`; without `shadows` light passes through everything, and it is fast."""
        ...

    def close(self) -> None:
        """Give back what the renderer holds outside of Python; it cannot render afterwards."""
        ...


RENDERERS = ("auto", "pyrender", "tiny")
"""Names that `choose_renderer` knows."""

_live: dict[int, Renderer] = {}
"""The renderer of a process, by the process's number: a second OpenGL context in a process is where drivers
fail, and so is one that a child inherits."""


def choose_renderer(name: str = "auto") -> Renderer:
    """The renderer of that name; `auto` is pyrender over EGL where it works, else PyBullet's TinyRenderer.

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
    # Imported here: each needs packages and libraries of its own, and the other one works without them.
    if name in ("auto", "pyrender"):
        try:
            from synthetic.render.pyrender_renderer import PyrenderRenderer

            return PyrenderRenderer()
        except Exception as error:
            # What a missing driver raises is anything from ImportError to AttributeError.
            if name == "pyrender":
                raise RendererError(f"pyrender over EGL does not work here: {error!r}") from error
    try:
        from synthetic.render.tiny_renderer import TinyRenderer
    except ImportError as error:
        raise RendererError(f"no renderer works here; PyBullet is missing: {error}") from error
    return TinyRenderer()
