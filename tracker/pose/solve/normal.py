"""The normal equations that the offsets of one camera's strips add up to."""

from __future__ import annotations

import math

import numpy as np

from tracker.compiled import compiled
from tracker.pose.solve.robust import tukey
from tracker.pose.solve.step import EXPONENT, RIM, UNKNOWNS

KNOWN, PULL, ROW = 0, 1, 2
EDGE = ROW + UNKNOWNS
"""Of each edge: sums over its strips of weights, weighted offsets, and weighted motion with the unknowns."""


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
def accumulate(strips, offsets, n, since, exponent, rim, limit, floor, trust, matrix, vector, seen, edges):  # type: ignore[no-untyped-def]
    """Add n weighted offsets to the normal equations (8, 8), (8,) and to the record `seen` (SEEN).

    Weights are those of equation (14) of docs/how-it-works.md.
    limit: residual [px] at which a weight reaches zero; floor: variance of an edge's place [px²] that noise
    does not explain; trust: factor on all weights.
    edges (12, EDGE), zeros: filled with what `integrate_out` needs of each edge.
    """
    row = np.empty(UNKNOWNS)
    for s in range(n):
        if not offsets[s].usable:
            continue
        r = residual(strips[s], offsets[s], since, exponent, rim)
        robust = tukey(r, limit)
        if robust <= 0.0:
            continue
        seen.inliers += robust
        seen.squares += robust * r * r
        weight = trust * robust / (floor + offsets[s].variance)
        for i in range(6):
            row[i] = strips[s].jacobian[i]
        row[EXPONENT], row[RIM] = offsets[s].bloom, strips[s].rim
        edge = edges[strips[s].edge]
        edge[KNOWN] += weight
        edge[PULL] += weight * r
        for i in range(UNKNOWNS):
            vector[i] += weight * row[i] * r
            edge[ROW + i] += weight * row[i]
            for k in range(i + 1):
                matrix[i, k] += weight * row[i] * row[k]
    for i in range(UNKNOWNS):
        for k in range(i):
            matrix[k, i] = matrix[i, k]


@compiled
def integrate_out(edges, own, matrix, vector):  # type: ignore[no-untyped-def]
    """Take from the normal equations (8, 8), (8,) what edges' own offsets, which are unknown, may explain.

    All pieces of an edge may be off together, since it is worn, lit, or printed otherwise than the model has
    it; see below equation (14) of docs/how-it-works.md.
    edges (12, EDGE): see `accumulate`; own: variance of these offsets [px²].
    """
    for e in range(len(edges)):
        edge = edges[e]
        if edge[KNOWN] == 0.0:
            continue
        known = edge[KNOWN] + 1.0 / own
        for i in range(UNKNOWNS):
            vector[i] -= edge[ROW + i] * edge[PULL] / known
            for k in range(UNKNOWNS):
                matrix[i, k] -= edge[ROW + i] * edge[ROW + k] / known


@compiled
def unlikely(edges, own):  # type: ignore[no-untyped-def]
    """Minus twice the logarithm of the offsets' likelihood as far as it depends on the edges' own."""
    total = 0.0
    for e in range(len(edges)):
        if edges[e, KNOWN] > 0.0:
            total += math.log(1.0 + own * edges[e, KNOWN])
            total -= edges[e, PULL] ** 2 / (edges[e, KNOWN] + 1.0 / own)
    return total
