"""Lateral chromatic aberration: a lens draws blue and red pictures a little larger or smaller than green."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tracker.conventions import FloatArray

CORNER = 135 * np.sqrt(2.0)
"""Distance of a corner from the centre of a picture of 270 × 270 [px]."""

MOST = 0.5
"""Greatest shift in that corner [px]."""


@dataclass(frozen=True)
class Fringes:
    """By how much colours are off in the corner of a picture of 270 × 270 [px], outwards; none in the centre.

    On photos of a board red edges lie 0.17 to 0.31 px, in the median 0.24 px, further out than green ones at
    half the height of a picture of 540 px, and blue ones 0.05 px (scripts/measure_cameras.py).
    """

    blue: float
    red: float

    @classmethod
    def sample(cls, rng: np.random.Generator) -> Fringes:
        """A lens like the measured ones, or a worse one."""
        red = 0.17 * np.exp(rng.normal(0.0, 0.5))
        blue = 0.04 + rng.normal(0.0, 0.08)
        return cls(float(np.clip(blue, -MOST, MOST)), float(np.clip(red, -MOST, MOST)))

    @property
    def stretch(self) -> FloatArray:
        """(3,) how much larger blue, green and red are drawn, about the principal point."""
        result: FloatArray = 1.0 + np.array([self.blue, 0.0, self.red]) / CORNER
        return result
