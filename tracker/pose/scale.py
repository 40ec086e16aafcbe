"""How large the object is in each picture, and what follows from that."""

from __future__ import annotations

SEARCH_SIZE = 135
"""Shorter side [px] of the label maps in which the object is searched and aligned."""


def reduced_size(width: int, height: int, shorter: int = SEARCH_SIZE) -> tuple[int, int]:
    """Size of an image reduced by a whole factor so that its shorter side comes nearest to `shorter`."""
    factor = max(1, round(min(width, height) / shorter))
    return width // factor, height // factor
