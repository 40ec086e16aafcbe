"""The robust kernel: how much a residual counts, and how far residuals scatter."""

from __future__ import annotations

from tracker.compiled import compiled
from tracker.geometry.linear import median

GAUSSIAN = 1.4826
"""Standard deviation of a normal distribution over its median deviation."""


@compiled(inline="always")
def tukey(residual, limit):  # type: ignore[no-untyped-def]
    """Tukey's biweight of a residual: 1 at zero, 0 from `limit` on."""
    if abs(residual) >= limit:
        return 0.0
    return (1.0 - (residual / limit) ** 2) ** 2


@compiled
def spread(residuals, n):  # type: ignore[no-untyped-def]
    """Robust standard deviation of the first n absolute residuals, whose order changes; 1 of none.

    The median of all, unlike the inliers' mean square, does not shrink by leaving out what disagrees.
    """
    return GAUSSIAN * median(residuals, n) if n > 0 else 1.0
