"""What each camera says of a pose: it supports it, it contradicts it, or it cannot tell."""

from __future__ import annotations

import functools
from typing import NamedTuple

from tracker.pose.fit import Fit

EXPECTED = 20
"""Pixels of its label map that the object must fill for a camera to have a say."""

SUPPORT = 10, 0.1
"""Least number and least share of these pixels that show the right face where a camera supports a pose."""

CONTRADICTION = 30, 0.15
"""Least number, as a share of the pixels expected, too, of pixels in the object's colours outside it, where
a camera that does not support a pose contradicts it: it sees the object somewhere else."""

MIN_VIEW = 4.0
"""Weight of the pieces of edges on which a camera must agree to count as seeing the object."""


class Witnesses(NamedTuple):
    """What the cameras together say of a pose."""

    supporting: tuple[bool, ...]
    contradicting: tuple[bool, ...]
    worst_wrong: float
    """Largest share of face-coloured pixels that show another face than expected, of a supporter."""
    blind: int
    """Supporters that see no edges."""

    @property
    def lonely(self) -> bool:
        """Whether at most one camera sees the object there, and another one elsewhere."""
        return sum(self.supporting) < 2 and any(self.contradicting)


@functools.lru_cache(maxsize=32)
def witnesses(fit: Fit) -> Witnesses:
    """What the cameras say of a fit."""
    supporting, contradicting = [], []
    worst, blind = 0.0, 0
    columns = (
        fit.cameras[key].tolist() for key in ("predicted", "agree", "wrong", "extra", "elsewhere", "inliers")
    )
    for predicted, agree, wrong, extra, elsewhere, inliers in zip(*columns, strict=True):
        speaks = predicted >= EXPECTED
        supports = speaks and agree >= max(SUPPORT[0], SUPPORT[1] * predicted) and wrong <= agree
        outside = extra + elsewhere + wrong
        supporting.append(supports)
        contradicting.append(
            speaks and not supports and outside >= max(CONTRADICTION[0], CONTRADICTION[1] * predicted)
        )
        if supports:
            worst = max(worst, wrong / (agree + wrong))
            blind += inliers < MIN_VIEW
    return Witnesses(tuple(supporting), tuple(contradicting), worst, blind)
