"""The probability that a pose with Gaussian errors is near the truth in position and in rotation at once."""

from __future__ import annotations

import math
from statistics import NormalDist

import numpy as np

from tracker.compiled import compiled
from tracker.conventions import FloatArray
from tracker.geometry.linear import factorise

DIRECTIONS = 1200
"""Directions over which is integrated: the result is good to 0.005."""

CERTAIN = 60.0
"""Squared distance, in standard deviations, of the limits beyond which no error is looked for."""


def _directions(count: int) -> FloatArray:
    """Unit vectors (N, 6) spread evenly: normal deviates of an additive recurrence (Roberts, R sequence)."""
    root = 1.0
    for _ in range(50):
        root = (1.0 + root) ** (1.0 / 7.0)
    steps = root ** -np.arange(1.0, 7.0)
    inverse = NormalDist().inv_cdf
    uniform = (0.5 + np.outer(np.arange(1, count + 1), steps)) % 1.0
    normal = np.array([[inverse(float(u)) for u in row] for row in uniform])
    result: FloatArray = normal / np.linalg.norm(normal, axis=1, keepdims=True)
    return result


_SPHERE = _directions(DIRECTIONS)


@compiled
def mass_within(covariance, near, turned, directions):  # type: ignore[no-untyped-def]
    """See `probability_within`."""
    spread, turn = 0.0, 0.0
    for i in range(6):
        if not covariance[i, i] > 0.0:
            return 0.0
    for i in range(3):
        spread += covariance[i, i]
        turn += covariance[3 + i, 3 + i]
    if min(near**2 / max(spread, 1e-300), turned**2 / max(turn, 1e-300)) > CERTAIN:
        return 1.0
    lower = np.zeros((6, 6))
    if not factorise(covariance, lower):
        return 0.0
    total = 0.0
    for n in range(len(directions)):
        # Along a direction of the unit ball the error grows in proportion: how far is it within limits?
        shift, turn = 0.0, 0.0
        for i in range(6):
            value = 0.0
            for k in range(i + 1):
                value += lower[i, k] * directions[n, k]
            if i < 3:
                shift += value * value
            else:
                turn += value * value
        half = 0.5 * min(near**2 / max(shift, 1e-300), turned**2 / max(turn, 1e-300))
        if half < CERTAIN:
            total += 1.0 - math.exp(-half) * (1.0 + half + 0.5 * half * half)
        else:
            total += 1.0
    return total / len(directions)


def probability_within(covariance: FloatArray, near: float, turned: float) -> float:
    """P(‖δp‖ < near and ‖δθ‖ < turned) of a Gaussian error with covariance (6, 6) [m, rad].

    This is equation (20) of docs/how-it-works.md.
    With the error L·r·w, L Lᵀ the covariance, w a unit vector and r² distributed as χ² with six degrees of
    freedom, the limits hold up to r² = min(near²/‖L_p w‖², turned²/‖L_θ w‖²); what is left is the mean over
    all directions w of the distribution of r² there. 0 where the covariance is not positive definite.
    """
    return float(mass_within(np.ascontiguousarray(covariance, dtype=np.float64), near, turned, _SPHERE))
