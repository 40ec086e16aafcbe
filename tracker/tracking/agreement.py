"""Whether the cameras agree over time: judged while the object rests, and remembered."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from tracker.conventions import FloatArray
from tracker.pose.agreement import probably_fits, size
from tracker.pose.fit import Fit
from tracker.pose.judge import fits
from tracker.tracking.filter import MotionState

EVERY = 5
"""Pictures after which the cameras are asked again."""

SHARE = 0.2
"""Of each look in what is remembered: an object at rest looks the same in one picture after the other."""

LOOKS = 5
"""Looks that a lasting contradiction takes."""

CONTRADICTION = 2e-3
"""Size of the cameras' errors [m] from which they contradict each other: each sees an object 3 mm or more off
where others have it. The recorded platforms' own calibrations stay below 1 mm."""

STILL = 0.005, math.radians(5)
"""Speeds up to which an object is still [m/s, rad/s]: cameras that are grabbed one after the other see one
that moves in different places."""

RESTS = 0.9
"""Probability that an object rests from which pictures that were taken one after another count: of one whose
velocity is not known yet they show the motion."""


class Agreement(NamedTuple):
    """What is remembered of how far the calibration is off."""

    disagreement: FloatArray | None = None
    """(S,) mean log likelihoods of `pose.agreement.SCALES`; None before the first look."""
    fitting: float = 1.0
    """Probability that the calibration leaves poses within 5 mm of the truth."""
    looks: int = 0
    age: int = EVERY
    """Pictures since the last look."""

    def due(self, expected: MotionState) -> bool:
        """Whether the cameras are to be asked again, about an object that is expected there."""
        return self.age + 1 >= EVERY and still(expected)

    def after(self, fit: Fit, expected: MotionState | None, *, lagging: bool = False) -> Agreement:
        """What is remembered after a pose of an object expected there; one that moves teaches nothing.

        lagging: whether the pictures were taken one after another.
        """
        if fit.disagreement is None:
            return self._replace(age=self.age + 1)
        if expected is None or not still(expected) or (lagging and expected.at_rest < RESTS):
            # It is all that is known of a first picture, unless what moved in between looks like it.
            fitting = fits(fit) if self.disagreement is None and not lagging else self.fitting
            return self._replace(fitting=fitting, age=self.age + 1)
        looked = fit.disagreement - fit.disagreement.max()
        before = looked if self.disagreement is None else self.disagreement
        mean = (1.0 - SHARE) * before + SHARE * looked
        return Agreement(mean, probably_fits(mean), self.looks + 1, 0)

    @property
    def contradicts(self) -> bool:
        """Whether the cameras contradict each other lastingly: the calibration is of others."""
        if self.disagreement is None or self.looks < LOOKS:
            return False
        return size(self.disagreement) > CONTRADICTION


def still(state: MotionState) -> bool:
    """Whether an object does not move so much that the cameras' moments matter."""
    return all(
        float(np.linalg.norm(part)) < limit
        for part, limit in zip((state.velocity[:3], state.velocity[3:]), STILL, strict=True)
    )
