"""How large errors are that pictures can tell: what cameras, and edges, have of their own."""

from __future__ import annotations

import math

import numpy as np

from tracker.compiled import compiled
from tracker.pose.solve import solve, with_edges

SHARES = np.array([100.0, 30.0, 10.0, 3.0, 1.0, 0.3, 0.1, 0.03, 0.01, 0.003, 0.001])
"""Shares of the stated calibration variance that the cameras' agreement is asked about; above 1 the cameras
disagree more than their files state."""

SHARES_PRIOR = np.array([0.02, 0.03, 0.04, 0.05, 0.26, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1])
"""Probability of each before the cameras are asked."""

MOVING_SHARE = 3
"""Number of the largest share under which a pose moves: with looser cameras an object that is not quite its
model would be taken for cameras that are off. How uncertain the pose is, may rest on larger ones."""

WEAR = np.array([0.0125, 0.03, 0.08, 0.18, 0.4]) ** 2
"""Variances of edges' own offsets that the edges are asked about [px² of an object of reference size]."""

WEAR_PRIOR = np.array([0.35, 0.25, 0.2, 0.15, 0.05])
"""Probability of each before the edges are asked."""

SHARED = 2.5
"""Factor on the variance of edges' own offsets that is found: they are alike in the cameras that see an edge,
and on all edges of a worn face."""

NEGLIGIBLE = 12.0
"""Twice the log odds by which a size may be behind the best and still counts."""


@compiled
def _likely_wears(solution, cameras, share, wears, doubts):  # type: ignore[no-untyped-def]
    """Fill doubts (W,) of variances (W,) of edges' own offsets, priors in; returns the least one's number."""
    best = 0
    for w in range(len(wears)):
        doubts[w] = with_edges(cameras, wears[w]) - 2.0 * math.log(WEAR_PRIOR[w])
        doubts[w] += solve(solution, cameras, share)
        if doubts[w] < doubts[best]:
            best = w
    return best


@compiled
def _likely_shares(solution, cameras, doubts):  # type: ignore[no-untyped-def]
    """Fill doubts (S,) of SHARES, priors in, from the stated one both ways until they do not count."""
    stated = int(np.argmin(np.abs(SHARES - 1.0)))
    doubts[:] = np.inf
    least = np.inf
    for way in (-1, 1):
        k = stated if way < 0 else stated + 1
        while 0 <= k < len(SHARES):
            doubts[k] = solve(solution, cameras, SHARES[k]) - 2.0 * math.log(SHARES_PRIOR[k])
            least = min(least, doubts[k])
            if doubts[k] > least + NEGLIGIBLE:
                break
            k += way


@compiled
def sizes(solution, cameras, doubtful, known):  # type: ignore[no-untyped-def]
    """How large errors are that pictures can tell: the cameras', and the edges' own.

    Both make the offsets of strips vary more than noise does, those of a camera all together, those of an
    edge by themselves. Each size is weighted with how likely it makes what was measured (empirical Bayes):
    equation (18) of docs/how-it-works.md. One is searched with the other at its likeliest.

    doubtful: whether the calibration states errors; known: variance of the edges' own offsets [px² of an
    object of reference size], 0 where it is to be found.

    Returns the mean share of the stated calibration variance among those under which a pose moves, the mean
    among all, and the mean variance of the edges' own offsets.
    """
    used = 0
    for c in range(len(cameras)):
        used += cameras[c].used
    several = doubtful and used > 1
    wears, shares = np.empty(len(WEAR)), np.empty(len(SHARES))
    own, share = known, 1.0
    for turn in range(2 if several and known == 0.0 else 1):
        if known == 0.0:
            own = WEAR[_likely_wears(solution, cameras, share, WEAR, wears)]
        if turn == 0 and several:
            with_edges(cameras, own)
            _likely_shares(solution, cameras, shares)
            share = SHARES[np.argmin(shares)]
            if share == 1.0:
                break
    if not several:
        # One camera does not tell how far it is off, and one that is exact is not.
        with_edges(cameras, own)
        shares[:] = solve(solution, cameras, 1.0)
        for k in range(len(SHARES)):
            shares[k] -= 2.0 * math.log(SHARES_PRIOR[k])
    least = shares.min()
    if not math.isfinite(least):
        return 1.0, 1.0, WEAR[0] if known == 0.0 else known
    total, mean, kept, moving = 0.0, 0.0, 0.0, 0.0
    for k in range(len(SHARES)):
        weight = math.exp(-0.5 * (shares[k] - least))
        total += weight
        mean += weight * SHARES[k]
        if k >= MOVING_SHARE:
            kept += weight
            moving += weight * SHARES[k]
    moving = moving / kept if kept > 0.0 else SHARES[MOVING_SHARE]
    if known > 0.0:
        return moving, mean / total, known
    least, weights, found = wears.min(), 0.0, 0.0
    for w in range(len(WEAR)):
        weight = math.exp(-0.5 * (wears[w] - least))
        weights += weight
        found += weight * WEAR[w]
    return moving, mean / total, SHARED * found / weights
