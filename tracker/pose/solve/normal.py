"""The normal equations that the offsets of one camera's strips add up to."""

from __future__ import annotations

import numpy as np

from tracker.compiled import compiled
from tracker.pose.solve.robust import tukey
from tracker.pose.solve.step import EXPONENT, GROWTH, UNKNOWNS


@compiled(inline="always")
def residual(strip, found, since, exponent, growth):  # type: ignore[no-untyped-def]
    """Offset of an edge [px] that is left: equation (13) of docs/how-it-works.md.

    since (6,): motion of the pose since it was measured.
    """
    left = found.offset - exponent * found.bloom - growth * strip.growth
    for i in range(6):
        left -= strip.jacobian[i] * since[i]
    return left


@compiled
def accumulate(strips, offsets, n, since, exponent, growth, limit, floor, matrix, vector, seen):  # type: ignore[no-untyped-def]
    """Add n weighted offsets to the normal equations (8, 8), (8,) and to the record `seen` (SEEN).

    Weights are those of equation (14) of docs/how-it-works.md.
    limit: residual [px] at which a weight reaches zero; floor: variance of an edge's place [px²] that noise
    does not explain.
    """
    row = np.empty(UNKNOWNS)
    for s in range(n):
        if not offsets[s].usable:
            continue
        r = residual(strips[s], offsets[s], since, exponent, growth)
        robust = tukey(r, limit)
        if robust == 0.0:
            continue
        seen.inliers += robust
        seen.squares += robust * r * r
        weight = robust / (floor + offsets[s].variance)
        for i in range(6):
            row[i] = strips[s].jacobian[i]
        row[EXPONENT], row[GROWTH] = offsets[s].bloom, strips[s].growth
        for i in range(UNKNOWNS):
            vector[i] += weight * row[i] * r
            for k in range(i + 1):
                matrix[i, k] += weight * row[i] * row[k]
    for i in range(UNKNOWNS):
        for k in range(i):
            matrix[k, i] = matrix[i, k]
