"""The probability that a pose with Gaussian errors is near the truth in both position and rotation."""

import math
from statistics import NormalDist

import numpy as np

from tracker.compiled import compiled
from tracker.conventions import FloatArray
from tracker.geometry.linear import factorise

CERTAIN = 60.0
"""Squared distance of the limits, in standard deviations, beyond which the probability counts as 1."""


def _directions(count: int) -> FloatArray:
    """Return evenly spread unit vectors (6, N): normal deviates of an additive recurrence (Roberts' R)."""
    root = 1.0
    for _ in range(50):
        root = (1.0 + root) ** (1.0 / 7.0)
    steps = root ** -np.arange(1.0, 7.0)
    inverse = NormalDist().inv_cdf
    uniform = (0.5 + np.outer(np.arange(1, count + 1), steps)) % 1.0
    normal = np.array([[inverse(float(u)) for u in row] for row in uniform])
    return np.ascontiguousarray((normal / np.linalg.norm(normal, axis=1, keepdims=True)).T)


_SPHERE = _directions(1200)
"""Directions to integrate over: with so many, the result is accurate to 0.01, mostly to 0.003."""


@compiled
def mass_within(covariance, near, turned, directions):  # type: ignore[no-untyped-def]
    """Return the probability of `probability_within`, compiled."""
    lower = np.zeros((6, 6))
    if not factorise(covariance, lower):
        return 0.0
    # The trace bounds the largest eigenvalue.
    place = covariance[0, 0] + covariance[1, 1] + covariance[2, 2]
    turn = covariance[3, 3] + covariance[4, 4] + covariance[5, 5]
    if min(near**2 / place, turned**2 / turn) > CERTAIN:
        return 1.0
    # Along a direction the error grows linearly: find how far it stays within both limits.
    count, total = directions.shape[1], 0.0
    squares, along = np.zeros((2, count)), np.empty(count)
    for i in range(6):
        # One direction after another, so that several are computed at once.
        for n in range(count):
            along[n] = lower[i, 0] * directions[0, n]
        for k in range(1, i + 1):
            for n in range(count):
                along[n] += lower[i, k] * directions[k, n]
        for n in range(count):
            squares[i // 3, n] += along[n] * along[n]
    for n in range(count):
        half = 0.5 * min(near**2 / max(squares[0, n], 1e-300), turned**2 / max(squares[1, n], 1e-300))
        if half < CERTAIN:
            total += 1.0 - math.exp(-half) * (1.0 + half + 0.5 * half * half)
        else:
            total += 1.0
    return max(total, 0.0) / count  # rounding errors may exceed a tiny total


def probability_within(covariance: FloatArray, near: float, turned: float) -> float:
    """Return P(‖δp‖ < near and ‖δθ‖ < turned) for a Gaussian error with covariance (6, 6) [m, rad].

    This is equation (20) of docs/how-it-works.md.
    The error is L·r·w with covariance L Lᵀ, a unit vector w, and r² distributed as χ² with six degrees of
    freedom. The limits hold up to r² = min(near²/‖L_p w‖², turned²/‖L_θ w‖²); the result is the mean of the
    χ² distribution function there over all directions w. It is 0 if the covariance is not positive definite.
    """
    # Numba would compile the function once more for a read-only array, and for whole numbers.
    one = np.array(covariance, dtype=np.float64, order="C")
    return float(mass_within(one, float(near), float(turned), _SPHERE))
