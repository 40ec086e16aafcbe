"""The normal equations that the offsets of one camera's strips add up to."""

from __future__ import annotations

import numpy as np

from tracker.compiled import compiled
from tracker.pose.solve.robust import tukey
from tracker.pose.solve.step import EXPONENT, RIM, UNKNOWNS

SHARED = 6.0
"""Factor on the variance of edges' own offsets: most edges are seen by several cameras, to which their
offsets are common, and which do not know of each other here."""


@compiled(inline="always")
def residual(strip, found, since, exponent, rim):  # type: ignore[no-untyped-def]
    """Offset of an edge [px] that is left: equation (13) of docs/how-it-works.md.

    since (6,): motion of the pose since it was measured.
    """
    left = found.offset - exponent * found.bloom - rim * strip.rim
    for i in range(6):
        left -= strip.jacobian[i] * since[i]
    return left


@compiled
def accumulate(strips, offsets, n, since, exponent, rim, limit, floor, own, matrix, vector, seen, edges):  # type: ignore[no-untyped-def]
    """Add n weighted offsets to the normal equations (8, 8), (8,) and to the record `seen` (SEEN).

    Weights are those of equation (14) of docs/how-it-works.md. All pieces of an edge may be off together,
    since it is worn, lit, or printed otherwise than the model has it; that offset is integrated out.
    limit: residual [px] at which a weight reaches zero; floor: variance of an edge's place [px²] that noise
    does not explain; own: variance of what all pieces of an edge have in common [px²].
    edges (12, 2), zeros: filled with the information on each edge's own offset [1/px²], and its pull.
    """
    row, common = np.empty(UNKNOWNS), np.zeros(UNKNOWNS)
    total, pull = 0.0, 0.0
    for s in range(n):
        if offsets[s].usable:
            r = residual(strips[s], offsets[s], since, exponent, rim)
            robust = tukey(r, limit)
            if robust > 0.0:
                seen.inliers += robust
                seen.squares += robust * r * r
                weight = robust / (floor + offsets[s].variance)
                for i in range(6):
                    row[i] = strips[s].jacobian[i]
                row[EXPONENT], row[RIM] = offsets[s].bloom, strips[s].rim
                for i in range(UNKNOWNS):
                    vector[i] += weight * row[i] * r
                    common[i] += weight * row[i]
                    for k in range(i + 1):
                        matrix[i, k] += weight * row[i] * row[k]
                total += weight
                pull += weight * r
        if total > 0.0 and (s + 1 == n or strips[s + 1].edge != strips[s].edge):
            known = total + 1.0 / (SHARED * own)
            for i in range(UNKNOWNS):
                vector[i] -= common[i] * pull / known
                for k in range(i + 1):
                    matrix[i, k] -= common[i] * common[k] / known
            edges[strips[s].edge, 0], edges[strips[s].edge, 1] = total, pull
            common[:] = 0.0
            total, pull = 0.0, 0.0
    for i in range(UNKNOWNS):
        for k in range(i):
            matrix[k, i] = matrix[i, k]
