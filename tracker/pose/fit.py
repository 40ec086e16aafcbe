"""A refined pose and what supports it."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tracker.conventions import Array, FloatArray
from tracker.pose.start import LIKELY, Start

SEEN = np.dtype(
    [
        ("expected", np.float64),  # pieces of visible edges
        ("usable", np.float64),  # of these, such as show an edge between the right colours
        ("inliers", np.float64),  # weight of the usable ones that lie where the pose puts them
        ("squares", np.float64),  # weighted sum of the inliers' squared residuals [px² at the reference]
        ("blur", np.float64),  # standard deviation of the picture's steps [px]
        ("predicted", np.int64),  # pixels of the label map that the object should cover
        ("agree", np.int64),  # of these, such as show the face that is expected there
        ("missing", np.int64),  # … that show background
        ("wrong", np.int64),  # … that show another face: they contradict the pose
        ("extra", np.int64),  # pixels beside the object in a face's colour
        ("elsewhere", np.int64),  # … and farther away
    ]
)
"""What one camera's picture says of a pose."""


class OwnViews(NamedTuple):
    """Where each camera by itself sees the object."""

    information: FloatArray
    """(C, 6, 6) on the pose that it sees [1/m², 1/rad²]; zero where it sees too little."""
    moved: FloatArray
    """(C, 6) that pose less the joint one [m, rad]."""
    inliers: FloatArray
    """(C,) weight of the pieces of edges that it rests on."""


@dataclass(frozen=True, eq=False)
class Fit:
    """A refined pose and what supports it."""

    position: FloatArray
    """(3,) [m]."""
    rotation: FloatArray
    """(3, 3) world_from_object."""
    covariance: FloatArray
    """(6, 6) [m, rad]."""
    cameras: Array
    """(C,) of SEEN."""
    converged: bool
    """Whether the refinement's last step was negligible."""
    iterations: int = 0
    """Steps that the refinement took."""
    end: Start = LIKELY
    """What the unknowns beside the pose turned out to be."""
    inside: bool = True
    """Whether the object is in the arena."""
    stands: float = 0.0
    """How well it stands on the table: log odds over an object that may be anywhere."""
    lead: float = math.inf
    """Log odds by which it leads over all clearly different poses together; infinite where none was tried."""
    left_out: tuple[int, ...] = ()
    """Cameras whose pictures were left out, since the others agree without them."""
    own: OwnViews | None = None
    """Where each camera by itself sees the object; None where it was not asked."""
    disagreement: FloatArray | None = None
    """(S,) log likelihoods of how far the calibration is off (`agreement.SCALES`); None: not judged."""

    def total(self, name: str) -> float:
        """Sum of a field of SEEN over the cameras."""
        return self._totals[name]

    @functools.cached_property
    def _totals(self) -> dict[str, float]:
        # Read one by one, they would cost more than the judgement that they are for.
        columns = zip(*self.cameras.tolist(), strict=True)
        return {name: float(sum(column)) for name, column in zip(SEEN.names or (), columns, strict=True)}
