"""The steps of the refinement, from a rough hypothesis or from a good start."""

from typing import NamedTuple

import numpy as np

from tracker.conventions import Array, FloatArray
from tracker.pose.solve import LEAST_LIMIT


class Schedule(NamedTuple):
    """Steps of the refinement."""

    blur: FloatArray
    """(steps,) standard deviation of the model's blur [px]; 0: as measured."""
    piece: FloatArray
    """(steps,) length of a piece of edge [px]."""
    tukey: FloatArray
    """(steps,) smallest residual at which a piece's weight reaches zero [px]."""
    every: Array
    """(steps,) n if only every n-th piece is used; it never grows, and is 1 from the second step on."""
    negligible: FloatArray
    """(steps,) squared length of a step [standard deviations of the pose] below which the refinement ends."""
    moves: bool = True
    """Whether the pose moves; otherwise each step measures the edges at the given pose."""


SCHEDULE = Schedule(
    blur=np.array([1.2] + [0.0] * 7),
    piece=np.array([6.0] + [5.0] * 7),
    tukey=np.array([4.0, 3.0, 1.0] + [LEAST_LIMIT] * 5),
    every=np.array([2] + [1] * 7),
    # Each step is about a twentieth of the one before (squared). If few pixels decide, pieces come and go
    # from step to step, and the pose keeps moving.
    negligible=np.ones(8),
)
"""Refinement from a hypothesis."""

FIRST, FROM_THERE = (
    Schedule(*(column[steps] for column in SCHEDULE[:5]))  # type: ignore[arg-type]
    for steps in (slice(1), slice(1, None))
)
"""The first step of SCHEDULE, and the remaining ones."""

FOLLOWING = Schedule(
    blur=np.zeros(5),
    piece=np.full(5, 6.0),
    tukey=SCHEDULE.tukey[2:7],
    every=np.array([2] + [1] * 4),
    negligible=np.full(5, 9.0),
)
"""Refinement from a predicted pose, with known blur. After a step of 9, half a squared standard deviation is
left, which the filter averages out over time."""

MEASURING = FROM_THERE._replace(blur=np.zeros(2), moves=False)
"""Measurement at a fixed pose: the second step uses the blur found by the first."""
