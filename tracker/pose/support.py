"""The table's prior on a pose: at rest on it, nearly so, held flat above it, on an edge, or anything else."""

import math
from typing import NamedTuple

import numpy as np

from tracker.compiled import compiled
from tracker.conventions import FloatArray
from tracker.geometry.arena import Arena
from tracker.geometry.cuboid import EDGES
from tracker.geometry.linear import factorise, invert, substitute
from tracker.pose.solution import ROWS

FLAT = np.array(
    [
        [0.2, 1e-4, math.radians(0.1)],  # at rest
        [0.1, 3e-3, math.radians(3.0)],  # nearly: on something, or leaned against it
        [0.25, 2e-2, math.radians(0.3)],  # held flat above the table
    ]
)
"""Ways to lie on a face: probability, standard deviation of the face's height [m], of its tilt [rad]."""

LEANING = 0.15, 1e-3, math.radians(3.0)
"""The same for standing on an edge: probability, standard deviation of its height [m], of its slope [rad]."""

FREE = (1.0 - FLAT[:, 0].sum() - LEANING[0]) / (4 * math.pi * 0.15)
"""Density of anything else: any rotation, up to 0.15 m above the table [1/(m sr)]."""

FACE_WAYS, EDGE_WAYS = 6.0, 6 * math.pi
"""A face is one of six; an edge one of twelve, over which the object may lean by a quarter turn."""

LIFTED = 2
"""The row of FLAT whose height is never negative."""

BELOW, SHADOWED = -0.8, 0.01
"""Largest z of the lower face's normal, and largest height of the lowest edge above the table, apart from the
latter's uncertainty, for it to lie in its own shadow [m]."""


class Table(NamedTuple):
    """What is known of the table."""

    known: bool
    """Whether there is a table, and objects are expected to rest on it."""
    center: FloatArray
    """(2,) where its height is known [m]."""
    height: float
    """z [m]; -inf if there is none."""
    variances: FloatArray
    """(3,) of its height [m²] and of its slopes [rad²]."""


def table_of(arena: Arena, support: bool) -> Table:
    """The table of an arena, if any; support: whether objects are expected to rest on it."""
    height, slope = arena.table_std
    at = -math.inf if arena.table is None else arena.table
    return Table(
        support and math.isfinite(at), np.array(arena.center), at, np.array([height, slope, slope]) ** 2
    )


@compiled
def mark_feet(table, half, solution):  # type: ignore[no-untyped-def]
    """Mark the edges that may lie in a contact shadow: those of the face below, if near the table."""
    up, feet = solution.rotation[2], solution.feet
    low = solution.position[2] - table.height
    for k in range(3):
        low -= abs(up[k]) * half[k]
    feet[:] = 0.0
    if low >= SHADOWED + 2.0 * math.sqrt(table.variances[0]):
        return
    for e in range(12):
        for face in EDGES[e, 2:]:
            normal = up[face // 2] if face % 2 == 0 else -up[face // 2]
            if normal < BELOW:
                feet[e] = 1.0


@compiled
def contacts_of(table, half, rotation, position, value, slope, plane):  # type: ignore[no-untyped-def]
    """Residuals of the object against the table; return the lowest edge's drop from middle to end [m].

    Filled: value (5,) of ROWS [m, rad], and its derivatives with respect to the pose, slope (5, 6), and to
    the table's height and slopes, plane (5, 3).
    """
    up = rotation[2]
    x, y = position[0] - table.center[0], position[1] - table.center[1]
    face, along = 0, 0
    for k in range(1, 3):
        face = k if abs(up[k]) > abs(up[face]) else face
        along = k if abs(up[k]) < abs(up[along]) else along
    slope[:, :], plane[:, :] = 0.0, 0.0
    for row, edge in ((0, False), (3, True)):
        value[row] = position[2] - table.height
        slope[row, 2] = 1.0
        plane[row, 0], plane[row, 1], plane[row, 2] = -1.0, -x, -y
        for k in range(3):
            if (k != along) if edge else (k == face):
                side = math.copysign(half[k], up[k])
                value[row] -= side * up[k]
                # Derivative of R_2k, the height of axis k, with respect to a rotation: (δθ × R_k)_z.
                slope[row, 3] -= side * rotation[1, k]
                slope[row, 4] += side * rotation[0, k]
    sign = math.copysign(1.0, up[face])
    nx, ny, nz = sign * rotation[0, face], sign * rotation[1, face], sign * up[face]
    value[1], value[2], value[4] = nx, ny, up[along]
    slope[1, 4], slope[1, 5] = nz, -ny
    slope[2, 5], slope[2, 3] = nx, -nz
    plane[1, 1], plane[2, 2] = 1.0, 1.0
    slope[4, 3], slope[4, 4] = rotation[1, along], -rotation[0, along]
    plane[4, 1], plane[4, 2] = -rotation[0, along], -rotation[1, along]
    return half[along] * abs(up[along])


@compiled
def _above(mean, variance):  # type: ignore[no-untyped-def]
    """Probability that a height is positive."""
    return 0.5 * math.erfc(-mean / math.sqrt(2.0 * max(variance, 1e-18)))


@compiled
def _way(rows, spread, noise, value, weights, force):  # type: ignore[no-untyped-def]
    """Log density of residuals value[rows[0] : rows[1]], with covariance spread + diag(noise), else NaN.

    Filled: weights (5, 5), the covariance's inverse, and force (5,), weights · value.
    """
    (first, last), n = rows, rows[1] - rows[0]
    matrix, lower = np.empty((n, n)), np.empty((n, n))
    weights[:, :], force[:] = 0.0, 0.0
    for i in range(n):
        for k in range(n):
            matrix[i, k] = spread[first + i, first + k]
        matrix[i, i] += noise[i]
    if not factorise(matrix, lower):
        return np.nan
    log = -0.5 * n * math.log(2 * math.pi)
    invert(lower, weights[first:last, first:last])
    for i in range(n):
        log -= math.log(lower[i, i])
        for k in range(first, last):
            force[first + i] += weights[first + i, k] * value[k]
        log -= 0.5 * value[first + i] * force[first + i]
    return log


@compiled
def reduce_by_table(solution):  # type: ignore[no-untyped-def]
    """Reduce a pose's covariance (6, 6) by what `apply_table` found."""
    columns, less, covariance = solution.columns, solution.less, solution.covariance
    for i in range(6):
        for k in range(i + 1):
            for row in range(ROWS):
                for other in range(ROWS):
                    covariance[i, k] -= columns[i, row] * less[row, other] * columns[k, other]
            covariance[k, i] = covariance[i, k]


@compiled
def _ways(spread, value, lower_end, logs, forces, weights):  # type: ignore[no-untyped-def]
    """Log densities of all ways to be placed, with forces and weights as in `_way`.

    spread (5, 5): covariance of value (5,). Filled: logs (6,), forces (6, 5), weights (6, 5, 5), of FLAT, on
    an edge, and free.
    """
    edge, free, noise = len(FLAT), len(FLAT) + 1, np.empty(3)
    for way in range(len(FLAT)):
        noise[0], noise[1], noise[2] = FLAT[way, 1] ** 2, FLAT[way, 2] ** 2, FLAT[way, 2] ** 2
        logs[way] = _way((0, 3), spread, noise, value, weights[way], forces[way])
        logs[way] += math.log(FLAT[way, 0] / FACE_WAYS)
        if way == LIFTED:
            # Only the positive part of the height's posterior counts.
            share = spread[0, 0] / (spread[0, 0] + noise[0])
            logs[way] += math.log(2.0 * _above(value[0] * (1.0 - share), noise[0] * share) + 1e-300)
    noise[0], noise[1] = LEANING[1] ** 2, LEANING[2] ** 2
    logs[edge] = _way((3, 5), spread, noise, value, weights[edge], forces[edge])
    logs[edge] += math.log(LEANING[0] / EDGE_WAYS)
    logs[free] = math.log(FREE * _above(value[3] - lower_end, spread[3, 3]) + 1e-300)
    forces[free, :], weights[free, :, :] = 0.0, 0.0
    for way in range(len(logs)):
        if not np.isfinite(logs[way]):
            logs[way] = -np.inf
            forces[way, :], weights[way, :, :] = 0.0, 0.0


@compiled
def _mix_ways(logs, forces, weights, mean, less):  # type: ignore[no-untyped-def]
    """Posterior mean (5,) of the forces; less (5, 5): mean weights minus the forces' covariance.

    Return the log of the summed densities; logs (6,) become probabilities.
    """
    most, total = -np.inf, 0.0
    for way in range(len(logs)):
        most = max(most, logs[way])
    for way in range(len(logs)):
        logs[way] = math.exp(logs[way] - most)
        total += logs[way]
    mean[:], less[:, :] = 0.0, 0.0
    for way in range(len(logs)):
        logs[way] /= total
        for i in range(ROWS):
            mean[i] += logs[way] * forces[way, i]
    for way in range(len(logs)):
        for i in range(ROWS):
            for k in range(ROWS):
                apart = (forces[way, i] - mean[i]) * (forces[way, k] - mean[k])
                less[i, k] += logs[way] * (weights[way, i, k] - apart)
    return most + math.log(total)


@compiled
def apply_table(table, half, solution):  # type: ignore[no-untyped-def]
    """Change a step so that it leads to the posterior mean of the pose, given the table.

    Given only the images, the pose is Gaussian around the step's result. The prior is a mixture of Gaussians
    and a uniform density, and so is the posterior; the step then leads to its mean: equation (28) of
    docs/how-it-works.md.

    Filled: the solution's `columns` and `less`, such that columns · less · columnsᵀ is the reduction of the
    pose's covariance. Return the log likelihood of the images relative to an object that may be anywhere.
    """
    n, columns, change = solution.size, solution.columns, solution.change
    value, slope, plane = np.empty(ROWS), np.empty((ROWS, 6)), np.empty((ROWS, 3))
    lower_end = contacts_of(table, half, solution.rotation, solution.position, value, slope, plane)
    spread, column, mean = np.empty((ROWS, ROWS)), np.empty(n), np.empty(ROWS)
    for row in range(ROWS):
        column[:] = 0.0
        for i in range(6):
            column[i] = slope[row, i]
            value[row] += slope[row, i] * change[i]
        substitute(solution.lower, column, columns[:, row])
    for row in range(ROWS):
        for other in range(ROWS):
            spread[row, other] = 0.0
            for i in range(6):
                spread[row, other] += slope[row, i] * columns[i, other]
            for i in range(3):
                spread[row, other] += plane[row, i] * table.variances[i] * plane[other, i]
    ways = len(FLAT) + 2
    logs, forces, weights = np.empty(ways), np.empty((ways, ROWS)), np.empty((ways, ROWS, ROWS))
    _ways(spread, value, lower_end, logs, forces, weights)
    total = _mix_ways(logs, forces, weights, mean, solution.less)
    for i in range(n):
        for row in range(ROWS):
            change[i] -= columns[i, row] * mean[row]
    return total - math.log(FREE)
