"""A refined pose and what supports it."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tracker.conventions import Array, FloatArray
from tracker.objects.model import RIM_STD


class Lag(NamedTuple):
    """Pictures that were taken before the moment for which the pose is asked, of an object that moves."""

    delays: FloatArray
    """(C,) since each camera's picture was taken [s]."""
    velocity: FloatArray
    """(6,) of the object [m/s, rad/s]."""
    covariance: FloatArray
    """(6, 6) of the velocity."""

    @property
    def moved(self) -> FloatArray:
        """(C, 6) by which the cameras see the object moved [m, rad].

        See equation (26) of docs/how-it-works.md.
        """
        return -self.delays[:, None] * self.velocity


class Start(NamedTuple):
    """What the unknowns beside the pose are taken to be at first; only the rim is drawn to it."""

    blur: float
    """Standard deviation of the pictures' steps [px of an object of reference size]."""
    exponent: float
    """Of the cameras' response, less 1."""
    rim: float
    """Distance of the faces' borders from the nominal edges [m], …"""
    rim_std: float
    """… and its standard deviation: the end is drawn to it."""


LIKELY = Start(blur=0.9, exponent=0.3, rim=0.0, rim_std=RIM_STD)
"""Where nothing is known: an exponent between that of simulations and of cameras."""

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
        ("shows", np.float64),  # probability that it shows the object there
        ("broken", np.float64),  # … and that the picture is of something else
        ("faces", np.int64, (6, 7)),  # pixels that each face should cover, by the label that they show
        ("inner", np.int64, (6, 7)),  # … such as lie wholly inside
    ]
)
"""What one camera's picture says of a pose."""

_NUMBERS = [name for name in SEEN.names or () if not SEEN[name].shape]


class Evidence(NamedTuple):
    """What speaks for a pose and against it."""

    body: float
    """Log odds of a body there with other colours or of another shape, over the object."""
    nothing: float
    """Log odds that there is nothing, over the object."""
    ahead: float
    """Log odds of the object over nothing by which fits compete: pixels on the faces' outlines count, too,
    since they are the first to show that a pose is off."""
    resized: float = -math.inf
    """Log odds of a body of which an edge is shorter or longer; minus infinity where it was not asked for."""


UNHEARD = Evidence(math.inf, math.inf, -math.inf)


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
    evidence: Evidence = UNHEARD
    """For it and against it; of a fit of which label maps were not asked, that it is nothing."""
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
    offsets: FloatArray | None = None
    """(C, 6) by which cameras see the object moved, since their calibration is not quite right [m, rad]."""
    lags: FloatArray | None = None
    """(C, 6) by which they do since their pictures are older [m, rad]; None: they are not."""
    own: OwnViews | None = None
    """Where each camera by itself sees the object; None where it was not asked."""
    disagreement: FloatArray | None = None
    """(S,) log likelihoods of how far the calibration is off (`agreement.SCALES`); None: not judged."""

    def total(self, name: str) -> float:
        """Sum of a field of SEEN over the cameras."""
        return sum(one[name] for one in self.counts)

    @functools.cached_property
    def counts(self) -> list[dict[str, float]]:
        """The records of SEEN as plain numbers: to read them one by one costs more than to judge them."""
        return [dict(zip(_NUMBERS, row, strict=True)) for row in self.cameras[_NUMBERS].tolist()]
