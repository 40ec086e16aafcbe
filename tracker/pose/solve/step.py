"""One Gauss-Newton step of everything that is unknown at once."""

from __future__ import annotations

import math

import numpy as np

from tracker.compiled import compiled
from tracker.geometry.linear import factorise, substitute

EXPONENT, GROWTH = 6, 7
UNKNOWNS = 8
"""Pose (6), and two that all cameras share: the exponent of their response, and the object's growth over
its model."""

OWN = 7
"""Of each camera: an offset of the pose (6), which its calibration error causes, and how much its exponent
deviates from that of all. They act as the first seven of what is shared."""


@compiled
def solve_step(equations, share, prior, pull, known, shared, changes):  # type: ignore[no-untyped-def]
    """Solve for the pose, exponent, growth and the cameras' offsets together.

    Returns minus twice the logarithm of the measurements' likelihood under this `share`, up to a constant;
    infinite, where the equations cannot be solved: equation (18) of docs/how-it-works.md. The step is
    equation (17) of docs/how-it-works.md, which minimises equation (16) of docs/how-it-works.md.

    Each camera sees the object moved by an offset η_c of its own, which its calibration error causes and
    whose inverse covariance is weights (C, 7, 7), the offset's part over share. It contributes the normal
    equations information (C, 8, 8), gradient (C, 8) at the pose moved by η_c; `equations` is the tuple of both,
    of offsets (C, 7) and of weights. Minimised is
    Σ ‖r_c - J_c (δ + (dη_c, 0))‖² + (η_c + dη_c)ᵀ W_c / share (η_c + dη_c) + δᵀ P δ - 2 δᵀ q with
    prior P (8, 8) and pull q (8,). The offsets are eliminated (Schur). Filled: known (8, 8), the
    information on what is shared with the offsets marginalised; shared (8,), its update; changes (C, 7), the
    offsets' updates.
    """
    information, gradient, offsets, weights = equations
    cameras = len(offsets)
    vector, column = np.empty(UNKNOWNS), np.empty(OWN)
    own, factors = np.empty((OWN, OWN)), np.empty((cameras, OWN, OWN))
    lower = np.empty((UNKNOWNS, UNKNOWNS))
    forces, shares = np.empty((cameras, OWN)), np.empty((cameras, OWN, UNKNOWNS))
    for i in range(UNKNOWNS):
        vector[i] = pull[i]
        for k in range(UNKNOWNS):
            known[i, k] = prior[i, k]
    doubt = 0.0
    for c in range(cameras):
        for i in range(OWN):
            forces[c, i] = gradient[c, i]
            for k in range(OWN):
                weight = weights[c, i, k] / share if i < 6 and k < 6 else weights[c, i, k]
                own[i, k] = information[c, i, k] + weight
                forces[c, i] -= weight * offsets[c, k]
                doubt += offsets[c, i] * weight * offsets[c, k]
        if not factorise(own, factors[c]):
            return np.inf
        doubt += 6.0 * math.log(share)
        for i in range(OWN):
            doubt += 2.0 * math.log(factors[c, i, i])
        substitute(factors[c], forces[c], changes[c])
        for i in range(OWN):
            doubt -= forces[c, i] * changes[c, i]
        for k in range(UNKNOWNS):
            for i in range(OWN):
                column[i] = information[c, i, k]
            substitute(factors[c], column, column)
            for i in range(OWN):
                shares[c, i, k] = column[i]
        for i in range(UNKNOWNS):
            vector[i] += gradient[c, i]
            for j in range(OWN):
                vector[i] -= shares[c, j, i] * forces[c, j]
            for k in range(i + 1):
                entry = information[c, i, k]
                for j in range(OWN):
                    entry -= information[c, j, i] * shares[c, j, k]
                known[i, k] += entry
    for i in range(UNKNOWNS):
        for k in range(i):
            known[k, i] = known[i, k]
    if not factorise(known, lower):
        return np.inf
    substitute(lower, vector, shared)
    for i in range(UNKNOWNS):
        doubt += 2.0 * math.log(lower[i, i]) - vector[i] * shared[i]
    for c in range(cameras):
        for i in range(OWN):
            for k in range(UNKNOWNS):
                changes[c, i] -= shares[c, i, k] * shared[k]
    return doubt


SHARES = np.array([100.0, 30.0, 10.0, 3.0, 1.0, 0.3, 0.1, 0.03, 0.01, 0.003, 0.001])
"""Shares of the stated calibration variance that the cameras' agreement is asked about; above 1 the cameras
disagree more than their files state."""

SHARES_PRIOR = np.array([0.001, 0.002, 0.007, 0.03, 0.36, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1])
"""Probability of each before the cameras are asked."""


@compiled
def calibration_share(equations, prior, pull, known, shared, changes):  # type: ignore[no-untyped-def]
    """Mean share of the stated calibration variance that explains how well the cameras agree.

    See equation (18) of docs/how-it-works.md.
    Arguments as of `solve_step`, whose outputs are work space here. The shares are weighted with their
    marginal likelihood (empirical Bayes): a calibration is often better than its file fears, and with
    offsets held smaller the cameras' exact directions count more than their coarse depths.
    """
    doubts = np.empty(len(SHARES))
    for k in range(len(SHARES)):
        doubts[k] = solve_step(equations, SHARES[k], prior, pull, known, shared, changes)
    least = np.min(doubts)
    if not np.isfinite(least):
        return 1.0
    total, mean = 0.0, 0.0
    for k in range(len(SHARES)):
        weight = SHARES_PRIOR[k] * math.exp(-0.5 * (doubts[k] - least))
        total += weight
        mean += weight * SHARES[k]
    return mean / total


@compiled
def marginal(joint, known):  # type: ignore[no-untyped-def]
    """Known (6, 6) = information on the pose where exponent and growth are unknown; joint (8, 8).

    See equation (19) of docs/how-it-works.md.
    """
    a, b, d = joint[EXPONENT, EXPONENT], joint[EXPONENT, GROWTH], joint[GROWTH, GROWTH]
    inverse = 1.0 / (a * d - b * b)
    for i in range(6):
        e, g = joint[i, EXPONENT], joint[i, GROWTH]
        for k in range(6):
            ek, gk = joint[EXPONENT, k], joint[GROWTH, k]
            known[i, k] = joint[i, k] - inverse * (e * (d * ek - b * gk) + g * (a * gk - b * ek))
