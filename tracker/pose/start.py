"""What a refinement knows beside a hypothesis when it begins."""

from __future__ import annotations

from typing import NamedTuple

from tracker.conventions import FloatArray


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
    """What the unknowns beside the pose are taken to be at first; the end is not bound to it."""

    blur: float
    """Standard deviation of the pictures' steps [px of an object of reference size]."""
    exponent: float
    """Of the cameras' response, less 1."""
    rim: float
    """Distance of the faces' borders from the nominal edges [m]."""


LIKELY = Start(blur=0.9, exponent=0.3, rim=0.0)
"""Where nothing is known: an exponent between that of simulations and of cameras."""
