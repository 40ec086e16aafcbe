"""A refined pose and what supports it."""

from __future__ import annotations

import math
from dataclasses import dataclass

from tracker.conventions import Array, FloatArray


@dataclass(frozen=True, eq=False)
class Fit:
    """A refined pose and what supports it."""

    position: FloatArray
    """(3,) [m]."""
    rotation: FloatArray
    """(3, 3) world_from_object."""
    covariance: FloatArray
    """(6, 6) [m, rad]."""
    samples: Array
    """(C, 5) of the edges' pieces, see `contour.EXPECTED` …; squares in px² at the reference focal length."""
    converged: bool
    """Whether the refinement's last step was negligible."""
    counts: Array
    """(C, 5) pixels of the label maps, see `align.AGREE` …"""
    lowest: float = 0.0
    """Height of the object's lowest corner [m]."""
    lead: float = math.inf
    """Log odds by which it leads over the best clearly different pose; infinite where none was tried."""
