"""A refined pose and its support."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from tracker.conventions import Array, FloatArray
from tracker.objects.model import RIM_STD


class Lag(NamedTuple):
    """Age of the images of a moving object, relative to the moment of its pose, and its velocity."""

    delays: FloatArray
    """(C,) time since each camera's image was taken [s]."""
    velocity: FloatArray
    """(6,) of the object [m/s, rad/s]."""
    covariance: FloatArray
    """(6, 6) of the velocity."""

    @property
    def moved(self) -> FloatArray:
        """(C, 6) displacement of the object in each camera's view [m, rad].

        See equation (26) of docs/how-it-works.md.
        """
        return -self.delays[:, None] * self.velocity


class Start(NamedTuple):
    """Initial values of the unknowns other than the pose; only the rim has a prior here."""

    blur: float
    """Standard deviation of the images' blur [px for an object of reference size]."""
    exponent: float
    """Exponent of the cameras' response, minus 1."""
    rim: float
    """Prior mean of the distance of the face colours from the nominal edges [m]."""
    rim_std: float
    """Prior standard deviation of that [m]."""


LIKELY = Start(blur=0.9, exponent=0.3, rim=0.0, rim_std=RIM_STD)
"""Used if nothing is known: the exponent lies between those of simulations and of cameras."""


class Seen(NamedTuple):
    """What one camera's image shows of a pose, apart from each face's pixels."""

    expected: float
    """Number of pieces of visible edges."""
    usable: float
    """… that show an edge between the right colours."""
    inliers: float
    """Weight of the usable ones where the pose puts them."""
    squares: float
    """Weighted sum of the inliers' squared residuals [px² at reference size]."""
    noise: float
    """… and of their variances from image noise."""
    blur: float
    """Standard deviation of the image's blur [px]."""
    predicted: float
    """Number of pixels of the label map that the object should cover."""
    agree: float
    """… that show the expected face."""
    missing: float
    """… that show background."""
    wrong: float
    """… that show another face: they contradict the pose."""
    extra: float
    """Number of pixels beside the object in a face's colour."""
    elsewhere: float
    """… and farther away."""
    shows: float
    """Probability that it shows the object there."""
    broken: float
    """… and that the image shows something else."""


SEEN = np.dtype(
    [
        *((name, np.float64) for name in Seen._fields),
        ("faces", np.int64, (6, 7)),  # pixels that each face should cover, by their label
        ("inner", np.int64, (6, 7)),  # … that lie wholly inside it
    ]
)
"""What one camera's image shows of a pose: `Seen` as a record, and each face's pixels."""


class Evidence(NamedTuple):
    """Evidence for a pose and against it."""

    body: float
    """Log odds of a body with other colours or of another shape, over the object."""
    nothing: float
    """Log odds that there is nothing, over the object."""
    ahead: float
    """Log odds of the object over nothing, by which fits compete: pixels on outlines count, too, since they
    are the first to show that a pose is off."""


UNHEARD = Evidence(math.inf, math.inf, -math.inf)


class OwnViews(NamedTuple):
    """Where each camera sees the object on its own."""

    information: FloatArray
    """(C, 6, 6) of the pose that it sees [1/m², 1/rad²]; zero if it sees too little."""
    moved: FloatArray
    """(C, 6) that pose minus the joint pose [m, rad]."""
    inliers: FloatArray
    """(C,) weight of the pieces of edge it rests on."""


@dataclass(eq=False)  # frozen, it would take twice as long to create
class Fit:
    """A refined pose and its support."""

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
    """Evidence for and against it; before the label maps are counted, that nothing is there."""
    resized: float = -math.inf
    """Log odds of a body with one edge shorter or longer; minus infinity if not computed."""
    end: Start = LIKELY
    """Final values of the unknowns other than the pose."""
    inside: bool = True
    """Whether the object is in the arena."""
    stands: float = 0.0
    """Log odds that it stands on the table, over an object that may be anywhere."""
    lead: float = math.inf
    """Log odds over all clearly different poses together; infinite if none was tried."""
    left_out: tuple[int, ...] = ()
    """Cameras whose images were left out because the others agree without them."""
    as_they_are: bool = False
    """Whether it was found in images whose greys keep their colour and brightness."""
    shaded: bool = False
    """Whether colours were read as those of faces in shade."""
    shifts: FloatArray | None = None
    """(C, 6) displacement of the object in the cameras' views due to their calibration errors and the age of
    the images [m, rad]; None: no displacement."""
    own: OwnViews | None = None
    """Where each camera sees the object on its own; None: not estimated."""
    disagreement: FloatArray | None = None
    """(S,) log likelihoods of how far the calibration is off (`agreement.SCALES`); None: not judged."""

    def changed(self, **fields: Any) -> Fit:
        """Return a copy with some fields other than `cameras` replaced; the cached `counts` remain."""
        other = object.__new__(Fit)
        other.__dict__.update(self.__dict__, **fields)
        return other

    @functools.cached_property
    def counts(self) -> list[Seen]:
        """The records of SEEN as plain numbers: reading array fields one by one is slower than judging."""
        rows = self.cameras.view(np.float64).reshape(len(self.cameras), -1)
        return [Seen(*row) for row in rows[:, : len(Seen._fields)].tolist()]
