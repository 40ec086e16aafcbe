"""What goes into a renderer beside a scene, and what comes out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from tracker.conventions import FloatArray, Image


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
    block: int = 1
    """Pixels within squares of this size may share the light of one of them where they show one surface: a
    camera's pixel that consists of so many has exact edges, and is looked at about once."""


@dataclass(frozen=True, eq=False)
class Layers:
    """What a view shows, one value per pixel: that of the point that the pixel's central ray meets."""

    color: npt.NDArray[np.float32]
    """(h, w, 3) linear BGR light: reflectance × irradiance, may exceed 1."""
    labels: Image
    """(h, w) uint8 label of the visible surface; 0 for what is no object."""
    alone: Image
    """(h, w) uint8 labels if there were nothing but the objects, as the base of visible fractions."""
    nearness: npt.NDArray[np.float32]
    """(h, w) 1 / depth along the view's axis [1/m]; 0 where nothing is."""
