"""One Gauss-Newton step of everything that is unknown at once."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from tracker.compiled import compiled
from tracker.conventions import FloatArray
from tracker.geometry.linear import factorise, substitute

EXPONENT, RIM = 6, 7
UNKNOWNS = 8
"""Pose (6), and two that all cameras share: the exponent of their response, and the rim of
the object's edges."""

MOVING = UNKNOWNS + 6
"""Where cameras lag behind, the object's velocity is unknown, too: its change from what is expected."""

OWN = 7
"""Of each camera: an offset of the pose (6), which its calibration error causes, and how much its exponent
deviates from that of all. They act as the first seven of what is shared."""


class Step(NamedTuple):
    """What a step works out, n unknowns being shared; filled in place."""

    known: FloatArray
    """(n, n) information on what is shared, with all else marginalised."""
    lower: FloatArray
    """(n, n) its Cholesky factor."""
    shared: FloatArray
    """(n,) update of what is shared."""
    reduced: FloatArray
    """(C, OWN, UNKNOWNS) by which a camera's own changes less per unit of what is shared."""
    changes: FloatArray
    """(C, OWN) update of what is the cameras' own: where what is shared stays, until `own_changes`."""


@compiled
def blank_step(cameras, n):  # type: ignore[no-untyped-def]
    """Room for the step of n unknowns that are shared."""
    return Step(
        np.zeros((n, n)), np.zeros((n, n)), np.zeros(n), np.zeros((cameras, OWN, UNKNOWNS)),
        np.zeros((cameras, OWN)),
    )  # fmt: skip


@compiled
def _eliminate(equations, c, share, own, factor, force, change, reduced):  # type: ignore[no-untyped-def]
    """Solve camera c for what is its own, in terms of what is shared.

    Filled: factor (7, 7), force (7,), change (7,) where what is shared stays, reduced (7, 8): change per unit
    of what is shared. Returns its part of the doubt, see `solve_step`; infinite where it cannot be solved.
    """
    information, gradient, offsets, weights = equations[0], equations[1], equations[2], equations[3]
    doubt = 6.0 * math.log(share)
    for i in range(OWN):
        force[i] = gradient[c, i]
        for k in range(OWN):
            weight = weights[c, i, k] / share if i < 6 and k < 6 else weights[c, i, k]
            own[i, k] = information[c, i, k] + weight
            force[i] -= weight * offsets[c, k]
            doubt += offsets[c, i] * weight * offsets[c, k]
    if not factorise(own, factor):
        return np.inf
    substitute(factor, force, change)
    blind = True
    for i in range(OWN):
        doubt += 2.0 * math.log(factor[i, i]) - force[i] * change[i]
        blind = blind and information[c, i, i] == 0.0
    column = np.empty(OWN)
    for k in range(UNKNOWNS):
        for i in range(OWN):
            column[i] = information[c, i, k]
        substitute(factor, column, column)
        for i in range(OWN):
            reduced[i, k] = column[i]
    return 0.0 if blind else doubt  # else rounding would have it say something


@compiled
def _add(delay, schur, right, known, vector):  # type: ignore[no-untyped-def]
    """Add a camera's equations schur (8, 8), right (8,) to known (n, n), vector (n,), lower half.

    Its picture is `delay` old: it sees the pose less the delay times the change of velocity, see
    equation (26) of docs/how-it-works.md.
    """
    for i in range(UNKNOWNS):
        vector[i] += right[i]
        for k in range(i + 1):
            known[i, k] += schur[i, k]
    if delay == 0.0:
        return
    for i in range(6):
        vector[UNKNOWNS + i] -= delay * right[i]
        for k in range(UNKNOWNS):
            known[UNKNOWNS + i, k] -= delay * schur[max(i, k), min(i, k)]
        for k in range(i + 1):
            known[UNKNOWNS + i, UNKNOWNS + k] += delay**2 * schur[i, k]


@compiled
def solve_step(equations, share, prior, pull, step):  # type: ignore[no-untyped-def]
    """Solve for the pose, exponent and rim, whatever the cameras have of their own.

    Returns minus twice the logarithm of the measurements' likelihood under this `share`, up to a constant;
    infinite, where the equations cannot be solved: equation (18) of docs/how-it-works.md. The step is
    equation (17) of docs/how-it-works.md, which minimises equation (16) of docs/how-it-works.md.

    Each camera sees the object moved by an offset η_c of its own, which its calibration error causes and
    whose inverse covariance is weights (C, 7, 7), the offset's part over share. It contributes the normal
    equations information (C, 8, 8), gradient (C, 8) at the pose moved by η_c. `equations` is the tuple of
    both, of offsets (C, 7), weights, and delays (C,) [s]. Minimised is
    Σ ‖r_c - J_c (δ - d_c ν + (dη_c, 0))‖² + (η_c + dη_c)ᵀ W_c / share (η_c + dη_c) + δᵀ P δ - 2 δᵀ q with
    prior P (n, n) and pull q (n,); n is UNKNOWNS, or MOVING where cameras lag behind and the change of
    velocity ν is unknown, too. What is the cameras' own is eliminated (Schur), until `own_changes`.
    Filled: `step`.
    """
    information, gradient, offsets, delays = equations[0], equations[1], equations[2], equations[4]
    known, lower, shared = step.known, step.lower, step.shared
    cameras, n = len(offsets), len(shared)
    vector, right = pull.copy(), np.empty(UNKNOWNS)
    own, factor, schur = np.empty((OWN, OWN)), np.empty((OWN, OWN)), np.empty((UNKNOWNS, UNKNOWNS))
    force = np.empty(OWN)
    doubt = 0.0
    for i in range(n):
        for k in range(n):
            known[i, k] = prior[i, k]
    for c in range(cameras):
        doubt += _eliminate(equations, c, share, own, factor, force, step.changes[c], step.reduced[c])
        if not np.isfinite(doubt):
            return np.inf
        for i in range(UNKNOWNS):
            right[i] = gradient[c, i]
            for j in range(OWN):
                right[i] -= step.reduced[c, j, i] * force[j]
            for k in range(i + 1):
                schur[i, k] = information[c, i, k]
                for j in range(OWN):
                    schur[i, k] -= information[c, j, i] * step.reduced[c, j, k]
        _add(delays[c], schur, right, known, vector)
    for i in range(n):
        for k in range(i):
            known[k, i] = known[i, k]
    if not factorise(known, lower):
        return np.inf
    substitute(lower, vector, shared)
    for i in range(n):
        doubt += 2.0 * math.log(lower[i, i]) - vector[i] * shared[i]
    return doubt


@compiled
def own_changes(step, delays):  # type: ignore[no-untyped-def]
    """Let what is the cameras' own follow the update of what is shared; delays (C,) [s]."""
    n = len(step.shared)
    for c in range(len(delays)):
        for k in range(UNKNOWNS):
            change = step.shared[k]
            if k < 6 and n > UNKNOWNS:
                change -= delays[c] * step.shared[UNKNOWNS + k]
            for i in range(OWN):
                step.changes[c, i] -= step.reduced[c, i, k] * change


@compiled
def marginal(known, covariance):  # type: ignore[no-untyped-def]
    """Covariance (6, 6) of the pose where all else is unknown; known (n, n). False where there is none.

    See equation (19) of docs/how-it-works.md.
    """
    n = len(known)
    lower, column = np.zeros((n, n)), np.empty(n)
    if not factorise(known, lower):
        return False
    for k in range(6):
        column[:] = 0.0
        column[k] = 1.0
        substitute(lower, column, column)
        for i in range(6):
            covariance[i, k] = column[i]
    return True
