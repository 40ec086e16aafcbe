"""What a refinement knows beside a hypothesis when it begins."""

from __future__ import annotations

from typing import NamedTuple


class Start(NamedTuple):
    """What the unknowns beside the pose are taken to be at first; the end is not bound to it."""

    blur: float
    """Standard deviation of the pictures' steps [px of an object of reference size]."""
    exponent: float
    """Of the cameras' response, less 1."""
    growth: float
    """Of the object over its model, relative."""


LIKELY = Start(blur=0.9, exponent=0.3, growth=0.0)
"""Where nothing is known: an exponent between that of simulations and of cameras."""
