"""Where each camera sees the object on its own, as if no calibration tied it to the others."""

import numpy as np

from tracker.compiled import compiled
from tracker.geometry.linear import solve_positive
from tracker.objects.model import RIM_STD
from tracker.pose.fit import SEEN
from tracker.pose.solution import EXPONENT, RIM, UNKNOWNS
from tracker.pose.solve import (
    DEVIATION_STD,
    LEAST_LIMIT,
    accumulate,
    residual,
    robust_std,
    shown,
    with_edges,
)

ALONE_ROUNDS = 5
"""Iterations for a single camera: the first uses everything within the strips."""


@compiled
def _without_shared(matrix, out):  # type: ignore[no-untyped-def]
    """Fill out (6, 6): information on the pose, exponent and rim marginalised, from that on all (8, 8)."""
    a, b, d = matrix[EXPONENT, EXPONENT], matrix[EXPONENT, RIM], matrix[RIM, RIM]
    a, d = a + 1.0 / DEVIATION_STD**2, d + 1.0 / RIM_STD**2
    determinant = a * d - b * b
    for i in range(6):
        e, r = matrix[i, EXPONENT], matrix[i, RIM]
        for k in range(6):
            f, q = matrix[k, EXPONENT], matrix[k, RIM]
            out[i, k] = matrix[i, k] - (e * (d * f - b * q) + r * (a * q - b * f)) / determinant


@compiled
def see_alone(solution, cameras, work, own):  # type: ignore[no-untyped-def]
    """Solve for the pose that each camera sees on its own, as if no calibration tied it to the others.

    Uses the latest offsets. Unlike in the joint solution, everything within the strips counts at first, since
    a displaced camera shows all edges displaced.

    Args:
        solution: the joint one.
        cameras: as the joint solution left them; their sums are overwritten.
        work: the workspace with the offsets.
        own: OwnViews, filled.
    """
    information, moved, inliers = own
    matrix, vector = np.empty((UNKNOWNS, UNKNOWNS)), np.empty(UNKNOWNS)
    step, since, hold = np.empty(UNKNOWNS), np.empty(6), np.empty(UNKNOWNS)
    counted = np.zeros(1, SEEN)
    for i in range(6):
        hold[i] = solution.prior[i, i]
    # The rim that the images share does not count: light and wear differ from side to side.
    hold[EXPONENT], hold[RIM] = 1.0 / DEVIATION_STD**2, 1.0 / RIM_STD**2
    for c in range(len(cameras)):
        camera = cameras[c]
        information[c, :, :], moved[c, :], inliers[c] = 0.0, 0.0, 0.0
        if not camera.used:
            continue
        exponent, rim = shown(solution, camera)
        step[:], solved = 0.0, True
        for turn in range(ALONE_ROUNDS):
            for i in range(6):
                since[i] = camera.since[i] + step[i]
            drawn, total = (exponent + step[EXPONENT], rim + step[RIM]), 0
            for s in range(camera.strips):
                if work.found[c, s].usable:
                    off = residual(work.strips[c, s], work.found[c, s], since, drawn[0], drawn[1])
                    work.residuals[total] = abs(off) / camera.scale
                    total += 1
            least, scatter = LEAST_LIMIT if turn > 0 else np.inf, robust_std(work.residuals, total)
            accumulate(work.strips[c], work.found[c], camera, since, drawn, least, scatter, counted[0])
            with_edges(cameras[c : c + 1], solution.feet, solution.own, solution.foot)
            for i in range(UNKNOWNS):
                vector[i] = camera.gradient[i] - hold[i] * step[i]
                for k in range(UNKNOWNS):
                    matrix[i, k] = camera.information[i, k]
                matrix[i, i] += hold[i]
            solved = solve_positive(matrix, vector, vector)
            if not solved:
                break
            for i in range(UNKNOWNS):
                step[i] += vector[i]
        if solved:
            inliers[c] = counted[0].inliers
            _without_shared(camera.information, information[c])
            for i in range(6):
                moved[c, i] = camera.offset[i] + step[i]
