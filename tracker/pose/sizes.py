"""How large errors are that pictures can tell: what cameras, and edges, have of their own."""

from __future__ import annotations

import math

import numpy as np

from tracker.compiled import compiled
from tracker.pose.solve import solve, with_edges

SHARES = np.array([100.0, 30.0, 10.0, 3.0, 1.0, 0.3, 0.1, 0.03, 0.01, 0.003, 0.001])
"""Shares of the stated calibration variance that the cameras' agreement is asked about; above 1 the cameras
disagree more than their files state."""

SHARES_PRIOR = np.array([0.02, 0.04, 0.06, 0.12, 0.28, 0.12, 0.1, 0.08, 0.07, 0.06, 0.05])
"""Probability of each before the cameras are asked. Three cameras agree by chance far more often than files
exaggerate; with more on the small shares, generated scenes with errors of all kinds lie outside of their
covariances."""

MOVING_SHARE = 3
"""Number of the largest share under which a pose moves: with looser cameras an object that is not quite its
model would be taken for cameras that are off. How uncertain the pose is, may rest on larger ones."""

WEAR = np.array([0.0125, 0.03, 0.08, 0.18, 0.4]) ** 2
"""Variances of edges' own offsets that the edges are asked about [px² of an object of reference size]."""

WEAR_PRIOR = np.array([0.35, 0.25, 0.2, 0.15, 0.05])
"""Probability of each before the edges are asked."""

FEET = np.array([0.0, 1e-3, 3e-3]) ** 2
"""Variances that are asked about of how far above an edge near the table the colours end [m²]: they do in its
contact shadow, or where the edge is worn or dirty."""

FEET_PRIOR = np.array([0.5, 0.25, 0.25])
"""Probability of each before the edges are asked."""

FOOT_STD = math.sqrt(float(FEET @ FEET_PRIOR))
"""Standard deviation of that before they are [m]."""

WORN = WEAR**2 / (WEAR + 0.07**2)
"""Part of WEAR that is alike in the cameras that see an edge, and on all edges of a worn face: hardly any of
what sharp edges are off by, and most of what worn ones are."""

ALIKE = 16.0, 0.8
"""How often that counts, since cameras do not know of each other here: the first, less the second for one
camera in so many. Chosen on generated scenes, for worn boxes to lie in their covariances as sharp ones do."""

NEGLIGIBLE = 12.0
"""Twice the log odds by which a size may be behind the best and still counts."""


@compiled
def _likely(solution, cameras, share, sizes, prior, feet, doubts):  # type: ignore[no-untyped-def]
    """Fill doubts (W,) of variances (W,) of edges' own offsets or feet, priors in; returns the likeliest."""
    best = 0
    for w in range(len(sizes)):
        own, foot = (solution.own, sizes[w]) if feet else (sizes[w], solution.foot)
        doubts[w] = with_edges(cameras, solution.feet, own, foot) - 2.0 * math.log(prior[w])
        doubts[w] += solve(solution, cameras, share)
        if doubts[w] < doubts[best]:
            best = w
    return sizes[best]


@compiled
def _mean(sizes, doubts):  # type: ignore[no-untyped-def]
    """Mean of sizes (W,), each as likely as its doubt has it; that of the least where none is finite."""
    least, weights, mean = doubts.min(), 0.0, 0.0
    if not math.isfinite(least):
        return sizes[0]
    for w in range(len(sizes)):
        weight = math.exp(-0.5 * (doubts[w] - least))
        weights += weight
        mean += weight * sizes[w]
    return mean / weights


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
def sizes(solution, cameras, doubtful, ask):  # type: ignore[no-untyped-def]
    """How large errors are that pictures can tell: the cameras', and the edges' own.

    Both make the offsets of strips vary more than noise does, those of a camera all together, those of an
    edge by themselves. Each size is weighted with how likely it makes what was measured (empirical Bayes):
    equation (18) of docs/how-it-works.md. One is searched with the other at its likeliest.

    doubtful: whether the calibration states errors; ask: whether the edges are asked, too, else they keep
    the solution's variances `own` and `foot`, which otherwise are filled with the means.

    Returns the mean share of the stated calibration variance among those under which a pose moves, and the
    mean among all.
    """
    used = 0
    for c in range(len(cameras)):
        used += cameras[c].used
    several, standing = doubtful and used > 1, solution.feet.any()
    wears, feet, shares = np.empty(len(WEAR)), np.empty(len(FEET)), np.empty(len(SHARES))
    share = 1.0
    for turn in range(2 if several and ask else 1):
        if ask:
            solution.foot = 0.0
            solution.own = _likely(solution, cameras, share, WEAR, WEAR_PRIOR, False, wears)
            if standing:
                solution.foot = _likely(solution, cameras, share, FEET, FEET_PRIOR, True, feet)
            if solution.foot > 0.0:
                solution.own = _likely(solution, cameras, share, WEAR, WEAR_PRIOR, False, wears)
        if turn == 0 and several:
            with_edges(cameras, solution.feet, solution.own, solution.foot)
            _likely_shares(solution, cameras, shares)
            share = SHARES[np.argmin(shares)]
            if share == 1.0:
                break
    if not several:
        # One camera does not tell how far it is off, and one that is exact is not.
        with_edges(cameras, solution.feet, solution.own, solution.foot)
        shares[:] = solve(solution, cameras, 1.0)
        for k in range(len(SHARES)):
            shares[k] -= 2.0 * math.log(SHARES_PRIOR[k])
    least = shares.min()
    if not math.isfinite(least):
        if ask:
            solution.own = WEAR[0]
        return 1.0, 1.0
    if ask:
        solution.own = _mean(WEAR, wears) + ALIKE[0] * (1.0 - ALIKE[1] / max(used, 1)) * _mean(WORN, wears)
        if standing:
            solution.foot = _mean(FEET, feet)
    return _mean(SHARES[MOVING_SHARE:], shares[MOVING_SHARE:]), _mean(SHARES, shares)
