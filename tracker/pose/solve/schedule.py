"""How the refinement goes on, and its figures. Lengths in pixels are those of an object of reference size."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tracker.conventions import Array, FloatArray


class Schedule(NamedTuple):
    """The refinement's steps."""

    blur: FloatArray
    """(steps,) standard deviation of the model's steps [px]; 0: as measured."""
    piece: FloatArray
    """(steps,) length of the pieces of edges [px]."""
    tukey: FloatArray
    """(steps,) residual at which a piece's weight reaches zero: at least so much [px]."""
    every: Array
    """(steps,) one in so many pieces is looked at; the refinement ends after a step with all of them."""
    negligible: FloatArray
    """(steps,) squared length of a step, in standard deviations of the pose, below which the refinement
    ends."""


SCHEDULE = Schedule(
    blur=np.array([1.2] + [0.0] * 7),
    piece=np.array([6.0] + [5.0] * 7),
    tukey=np.array([4.0, 3.0, 1.0] + [0.5] * 5),
    every=np.array([2] + [1] * 7),
    # A step is about a twentieth of the one before (squared). Where few pixels decide, pieces come and go
    # from step to step, and the pose stays restless.
    negligible=np.ones(8),
)
"""From a hypothesis."""

FOLLOWING = Schedule(
    blur=np.zeros(5),
    piece=np.full(5, 6.0),
    tukey=np.array([1.0] + [0.5] * 4),
    every=np.array([2] + [1] * 4),
    negligible=np.full(5, 2.0),
)
"""From a pose that was predicted, with a blur that is known."""


class Tuning(NamedTuple):
    """Figures of the refinement."""

    reach: tuple[float, float]
    """Half width of the strips along the edges: [px], and for each px of blur."""
    least_reach: float
    """The least half width, in pixels of the picture whatever the object's size [px]."""
    margin: tuple[float, float]
    """Distance that pieces keep from corners, where three surfaces mix: [px], and for each px of blur."""
    floor: float
    """Standard deviation of an edge's place that noise does not explain [px]."""
    tukey: float
    """Residual at which a piece's weight reaches zero [robust standard deviations]."""
    correlation: float
    """Factor on the standard deviation of pieces where neighbouring pixels share errors: unless each of a
    mosaic's counts only for what it measured."""
    own: float
    """Standard deviation of what all pieces of an edge have in common, as it is expected to be [px]."""
    smear: float
    """Blur of which neighbouring pieces have twice the variance, since they share errors [px]."""
    largest_blur: float
    """Upper bound of the blur [px]."""
    least_blur: float
    """Its lower bound, in pixels of the picture whatever the object's size [px]."""
    longest: float
    """Longest step [radii of the object]; the strips say nothing on what lies farther away."""
    largest: float
    """Largest turn of a step [rad]."""
    stray: float
    """Motion of a strip at which its pixels are collected anew [half widths]."""
    rounds: int
    """Solutions with robust weights for each measurement of the offsets."""


TUNING = Tuning(
    reach=(1.2, 2.0),
    least_reach=2.5,
    margin=(0.4, 1.5),
    floor=0.06,
    tukey=4.685,
    correlation=1.1,
    own=0.05,
    smear=2.0,
    largest_blur=3.0,
    least_blur=0.5,
    longest=0.4,
    largest=0.3,
    stray=0.15,
    rounds=2,
)
