"""How large errors are that pictures can tell: those of the cameras' calibration, and edges' own.

Both make the offsets of strips vary more than noise does, those of a camera all together, those of an edge by
themselves. Each size is weighted with how likely it makes what was measured (empirical Bayes).
"""

from __future__ import annotations

import math

import numpy as np

from tracker.compiled import compiled
from tracker.pose.solve.normal import integrate_out, unlikely
from tracker.pose.solve.step import solve_step

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


@compiled
def with_edges(cameras, work, own):  # type: ignore[no-untyped-def]
    """Fill the normal equations for edges' own offsets of a variance [px² of an object of reference size]."""
    for c in range(len(cameras.used)):
        for i in range(work.force.shape[1]):
            work.gradient[c, i] = work.force[c, i]
            for k in range(work.force.shape[1]):
                work.information[c, i, k] = work.whole[c, i, k]
        if cameras.used[c]:
            integrate_out(work.edges[c], own * cameras.scales[c] ** 2, work.information[c], work.gradient[c])


@compiled
def sizes(cameras, equations, doubtful, own, prior, pull, work, step):  # type: ignore[no-untyped-def]
    """How large the cameras' errors and the edges' own are: equation (18) of docs/how-it-works.md.

    doubtful: whether the calibration states errors; own: variance of the edges' own offsets [px² of an object
    of reference size] where it is known, 0 where it is to be found; other arguments as of `solve_step`.
    `step` and the normal equations are work space here.

    Returns the mean share of the stated calibration variance among those under which a pose moves, the mean
    among all, and the mean variance of the edges' own offsets.
    """
    several = doubtful and np.sum(cameras.used) > 1
    variances = WEAR if own == 0.0 else np.full(1, own)
    doubts = np.empty((len(variances), len(SHARES)))
    for w in range(len(variances)):
        with_edges(cameras, work, variances[w])
        alike = 0.0
        for c in range(len(cameras.used)):
            if cameras.used[c]:
                alike += unlikely(work.edges[c], variances[w] * cameras.scales[c] ** 2)
        if several:
            for k in range(len(SHARES)):
                doubts[w, k] = alike + solve_step(equations, SHARES[k], prior, pull, step)
        else:  # one camera does not tell how far it is off
            doubts[w, :] = alike + solve_step(equations, 1.0, prior, pull, step)
    least = doubts.min()
    if not np.isfinite(least):
        return 1.0, 1.0, variances[0]
    total, mean, found, moving, kept = 0.0, 0.0, 0.0, 0.0, 0.0
    for w in range(len(variances)):
        for k in range(len(SHARES)):
            weight = SHARES_PRIOR[k] * math.exp(-0.5 * (doubts[w, k] - least))
            if own == 0.0:
                weight *= WEAR_PRIOR[w]
            total += weight
            mean += weight * SHARES[k]
            found += weight * variances[w]
            if k >= MOVING_SHARE:
                kept += weight
                moving += weight * SHARES[k]
    if own == 0.0:
        found *= SHARED
    return (moving / kept if kept > 0.0 else SHARES[MOVING_SHARE]), mean / total, found / total
