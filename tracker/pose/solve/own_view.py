"""Where each camera by itself sees the object, from the offsets that were measured for all together."""

from __future__ import annotations

import numpy as np

from tracker.compiled import compiled
from tracker.geometry.linear import factorise, substitute
from tracker.pose.solve.covariance import DEVIATION_STD
from tracker.pose.solve.normal import EDGE, accumulate, integrate_out, residual
from tracker.pose.solve.refine import trust_of
from tracker.pose.solve.robust import spread
from tracker.pose.solve.step import EXPONENT, RIM, UNKNOWNS

ROUNDS = 5
"""Solutions with robust weights: the first takes all that lies within the strips."""

LEAST_LIMIT = 0.5
"""Residual at which a weight reaches zero, at least [px of an object of reference size]."""

RIM_STD = 4e-4
"""Standard deviation of the rim as one camera sees it [m]: light and wear differ from side to side, and what
is taken for a rim moves the object along the line of sight."""


@compiled
def _scatter(strips, found, count, since, exponent, rim, scale, residuals):  # type: ignore[no-untyped-def]
    """How far the usable offsets of a camera scatter [px of an object of reference size]."""
    total = 0
    for s in range(count):
        if found[s].usable:
            residuals[total] = abs(residual(strips[s], found[s], since, exponent, rim)) / scale
            total += 1
    return spread(residuals, total)


@compiled
def _without_shared(matrix, out):  # type: ignore[no-untyped-def]
    """Information (6, 6) on the pose where exponent and rim are unknown, of that on all (8, 8)."""
    a, b, d = matrix[EXPONENT, EXPONENT], matrix[EXPONENT, RIM], matrix[RIM, RIM]
    a, d = a + 1.0 / DEVIATION_STD**2, d + 1.0 / RIM_STD**2
    determinant = a * d - b * b
    for i in range(6):
        e, r = matrix[i, EXPONENT], matrix[i, RIM]
        for k in range(6):
            f, q = matrix[k, EXPONENT], matrix[k, RIM]
            out[i, k] = matrix[i, k] - (e * (d * f - b * q) + r * (a * q - b * f)) / determinant


@compiled
def see_alone(cameras, unknowns, tuning, prior, work, seen, information, moved):  # type: ignore[no-untyped-def]
    """Solve for the pose of each camera by itself, as if no calibration bound it to the others.

    The offsets are those measured last. Other than in the joint solution all that lies within the strips
    counts at first, since a camera that is off shows all edges off.

    Args:
        cameras: what is known of them, `state.Cameras`.
        unknowns: the joint solution, `state.Unknowns`.
        tuning: `schedule.Tuning`.
        prior: (6,) information on the pose that holds what the camera does not see.
        work: where the offsets are, `state.Workspace`; its residuals are overwritten.
        seen: (C,) of SEEN, zeros; filled: weight of the inliers.
        information: (C, 6, 6), filled: on the pose that the camera sees; zero where it sees nothing.
        moved: (C, 6), filled: that pose less the joint one [m, rad].
    """
    matrix, vector = np.empty((UNKNOWNS, UNKNOWNS)), np.empty(UNKNOWNS)
    full, lower = np.empty((UNKNOWNS, UNKNOWNS)), np.empty((UNKNOWNS, UNKNOWNS))
    hold, step, change, since = np.empty(UNKNOWNS), np.empty(UNKNOWNS), np.empty(UNKNOWNS), np.empty(6)
    edges = np.empty((12, EDGE))
    for i in range(6):
        hold[i] = prior[i]
    hold[EXPONENT], hold[RIM] = 1.0 / DEVIATION_STD**2, 1.0 / RIM_STD**2
    for c in range(len(cameras.used)):
        information[c, :, :], moved[c, :] = 0.0, 0.0
        if not cameras.used[c]:
            continue
        scale, count = cameras.scales[c], work.counts[c]
        trust = trust_of(cameras.parts[c], unknowns.blurs[c], scale, tuning)
        exponent, rim = unknowns.shared[EXPONENT] + unknowns.offsets[c, EXPONENT], unknowns.shared[RIM]
        step[:], solved = 0.0, True
        for turn in range(ROUNDS):
            for i in range(6):
                since[i] = work.since[c, i] + step[i]
            here, border = exponent + step[EXPONENT], rim + step[RIM]
            scatter = _scatter(
                work.strips[c], work.found[c], count, since, here, border, scale, work.residuals
            )
            limit = work.reaches[c]
            if turn > 0:
                limit = min(limit, max(LEAST_LIMIT, tuning.tukey * scatter) * scale)
            matrix[:, :], vector[:], edges[:, :] = 0.0, 0.0, 0.0
            seen[c].inliers = 0.0
            accumulate(
                work.strips[c], work.found[c], count, since, here, border, limit,
                (max(tuning.floor, 0.7 * scatter) * scale) ** 2, trust, matrix, vector, seen[c], edges,
            )  # fmt: skip
            integrate_out(edges, unknowns.own[0] * scale**2, matrix, vector)
            for i in range(UNKNOWNS):
                vector[i] -= hold[i] * step[i]
                for k in range(UNKNOWNS):
                    full[i, k] = matrix[i, k]
                full[i, i] += hold[i]
            solved = factorise(full, lower)
            if not solved:
                break
            substitute(lower, vector, change)
            for i in range(UNKNOWNS):
                step[i] += change[i]
        if solved:
            _without_shared(matrix, information[c])
            for i in range(6):
                moved[c, i] = unknowns.offsets[c, i] + step[i]
