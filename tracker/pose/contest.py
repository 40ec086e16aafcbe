"""Of many hypotheses the best: all are refined a little, and those that are clearly behind are given up.

Most hypotheses of one camera lead to the same few poses, and a step or two tell which. (K. Jamieson and A.
Talwalkar, "Non-stochastic Best Arm Identification and Hyperparameter Optimization", AISTATS 2016, call such a
contest successive halving.)
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from tracker.conventions import FloatArray
from tracker.pose.fit import Fit
from tracker.pose.judge import rank
from tracker.pose.solve.refiner import Attempt

SAME_POSITION, SAME_ROTATION = 0.12, 0.15
"""Two hypotheses nearer than this [radii of the object, rad] are the same pose."""


SHARPER = 0.35
"""The same between attempts, over that between hypotheses: the winner of several that are nearly the same is
a little better than each."""


class Stage(NamedTuple):
    """A pause of the refinements, at which some are given up."""

    until: int
    """Step of the schedule before which they pause."""
    behind: float
    """Rank by which an attempt may be behind the best and still win."""


FROM_AFAR = Stage(1, 3.5), Stage(2, 2.5)
"""For hypotheses."""

REVERSED = (Stage(2, 5.0),)
"""For poses that are reversed in depth, against a finished one."""


def apart(
    rotation: FloatArray,
    position: FloatArray,
    rotation2: FloatArray,
    position2: FloatArray,
    radius: float,
    share: float = 1.0,
) -> bool:
    """Whether two poses differ by more than alignment on label maps leaves open, or than a share of that.

    radius: of the object [m].
    """
    # The trace of R R2ᵀ is 1 + 2 cos of the angle between them.
    if np.vdot(rotation, rotation2) < 1 + 2 * math.cos(share * SAME_ROTATION):
        return True
    moved = position - position2
    return math.sqrt(moved @ moved) > share * SAME_POSITION * radius


def contest(
    attempts: Sequence[Attempt],
    advance: Callable[[Attempt, int | None], Fit],
    stages: Sequence[Stage],
    radius: float,
    best: Fit | None = None,
) -> list[Fit]:
    """Fits of the attempts that hold out to the end, which differ from each other and from `best`.

    Args:
        attempts: at different hypotheses.
        advance: does an attempt's steps before the one given, or all, and says where it stands.
        stages: pauses, in their order.
        radius: of the object [m].
        best: a finished fit that they compete with.
    """
    for stage in stages:
        if not attempts or (best is None and len(attempts) == 1):
            break
        fits = [advance(attempt, stage.until) for attempt in attempts]
        ranks = [rank(fit) for fit in fits]
        least = max(ranks if best is None else [rank(best)]) - stage.behind
        kept = [] if best is None else [best]
        left = []
        for k in sorted(range(len(fits)), key=lambda k: -ranks[k]):
            fit = fits[k]
            if ranks[k] < least:
                break
            if all(
                apart(fit.rotation, fit.position, other.rotation, other.position, radius, SHARPER)
                for other in kept
            ):
                kept.append(fit)
                left.append(attempts[k])
        attempts = left
    return [advance(attempt, None) for attempt in attempts]


def lead(best: Fit, fits: Sequence[Fit], radius: float) -> float:
    """Log odds of the best fit over all clearly different ones together; infinite where there are none.

    fits: best first; radius: of the object [m].
    """
    different = [best]
    for fit in fits:
        if all(
            apart(fit.rotation, fit.position, other.rotation, other.position, radius) for other in different
        ):
            different.append(fit)
    if len(different) == 1:
        return math.inf
    behind = [rank(best) - rank(rival) for rival in different[1:]]
    least = min(behind)
    return least - math.log(sum(math.exp(least - one) for one in behind))
