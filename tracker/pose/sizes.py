"""Estimate from the images themselves how large the errors of cameras and edges are."""

import math

import numpy as np

from tracker.compiled import compiled
from tracker.geometry.linear import smallest, sum_from
from tracker.pose.solve import solve, with_edges

SHARES = np.array([30.0, 10.0, 3.0, 1.0, 0.3, 0.1, 0.03, 0.01, 0.003, 0.001])
"""Candidate shares of the stated calibration variance; above 1 the cameras disagree more than their files
state."""

SHARES_PRIOR = np.array([0.04, 0.06, 0.12, 0.3, 0.12, 0.1, 0.08, 0.07, 0.06, 0.05])
"""Prior probability of each. Three cameras agree by chance far more often than files overstate errors; with
more weight on small shares, generated scenes with errors of all kinds fall outside their covariances."""

WEAR = np.array([0.006, 0.03, 0.08, 0.18, 0.4]) ** 2
"""Candidate variances of edges' own offsets [px² for an object of reference size]."""

WEAR_PRIOR = np.array([0.35, 0.25, 0.2, 0.15, 0.05])
"""Prior probability of each."""

FEET = np.array([0.0, 1e-3, 3e-3]) ** 2
"""Candidate variances of how far above an edge near the table the colours end [m²], in its contact shadow or
where it is worn or dirty."""

FEET_PRIOR = np.array([0.5, 0.25, 0.25])
"""Prior probability of each."""

FOOT_STD = math.sqrt(float(FEET @ FEET_PRIOR))
"""Prior standard deviation of that height [m]."""

WORN = WEAR**2 / (WEAR + 0.07**2)
"""Part of WEAR that all cameras and all edges of a worn face share: hardly any of the offset of sharp edges,
and most of that of worn ones."""

ALIKE = 16.0, 0.8, 2.0
"""Weight of that part, since cameras are independent here: first × (1 - second / n), times the square of
n × (length of the mean of their viewing directions)² / third if that is above 1; n: number of cameras that
show edges. Chosen on generated scenes, so that worn boxes lie within their covariances as sharp ones do."""


@compiled
def _likely(solution, cameras, share, sizes, prior, feet, costs):  # type: ignore[no-untyped-def]
    """Fill costs (W,) of variances of edges' offsets or feet, with priors; return the likeliest."""
    for w in range(len(sizes)):
        own, foot = (solution.own, sizes[w]) if feet else (sizes[w], solution.foot)
        costs[w] = with_edges(cameras, solution.feet, own, foot) - 2.0 * math.log(prior[w])
        costs[w] += solve(solution, cameras, share)
    return sizes[smallest(costs)]


@compiled
def _mean(sizes, costs):  # type: ignore[no-untyped-def]
    """Posterior mean of sizes (W,), given their costs."""
    least, weights, mean = costs[smallest(costs)], 0.0, 0.0
    for w in range(len(sizes)):
        weight = math.exp(-0.5 * (costs[w] - least))
        weights += weight
        mean += weight * sizes[w]
    return mean / weights


@compiled
def seeing(cameras):  # type: ignore[no-untyped-def]
    """Number of cameras that show edges of the object, and how alike they see it (ALIKE)."""
    count, views = 0, np.zeros(3)
    for c in range(len(cameras)):
        if cameras[c].whole[0, 0] > 0.0:
            count += 1
            for i in range(3):
                views[i] += cameras[c].sight[i]
    return count, (views[0] ** 2 + views[1] ** 2 + views[2] ** 2) / max(count, 1)


@compiled
def sizes(solution, cameras, doubtful, ask):  # type: ignore[no-untyped-def]
    """Estimate the size of the cameras' errors and of the edges' own.

    Both scatter the offsets of strips more than noise does: a camera's shift all its strips together, an
    edge's only its own. Each candidate size is weighted by the likelihood of the measurements (empirical
    Bayes): equation (18) of docs/how-it-works.md. Each is estimated with the other at its most likely value.

    doubtful: whether the calibration states errors; ask: whether to estimate the edges' errors, too, and set
    the solution's variances `own` and `foot` to their posterior means.

    Return the mean share of the stated calibration variance.
    """
    count, alike = seeing(cameras)
    several, standing = doubtful and count > 1, sum_from(solution.feet, 0) > 0.0
    wears, feet, shares = np.empty(len(WEAR)), np.empty(len(FEET)), np.empty(len(SHARES))
    share = 1.0
    for k in range(len(SHARES)):
        shares[k] = -2.0 * math.log(SHARES_PRIOR[k])
    # A single camera cannot tell how far it is off, and an exact calibration is not off.
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
            for k in range(len(SHARES)):
                shares[k] += solve(solution, cameras, SHARES[k])
            share = SHARES[smallest(shares)]
            if share == 1.0:
                break
    if not math.isfinite(shares[smallest(shares)]):
        return 1.0
    if ask:
        weight = ALIKE[0] * (1.0 - ALIKE[1] / max(count, 1)) * max(1.0, alike / ALIKE[2]) ** 2
        solution.own = _mean(WEAR, wears) + weight * _mean(WORN, wears)
        if standing:
            solution.foot = _mean(FEET, feet)
    return _mean(SHARES, shares)
