"""The normal equations of all unknowns at once, and their solution.

The cameras share the pose (6), the exponent of their response and the rim of the object's edges. Each camera
has an offset of the pose (6), caused by its calibration error, and its own deviation of the exponent, which
act like the first seven shared unknowns; and each edge in each camera has an offset of its own. The edges'
and the cameras' own unknowns are eliminated.
"""

import math

import numpy as np

from tracker.compiled import compiled
from tracker.geometry.linear import congruence, factorise, invert, median
from tracker.pose.solution import EXPONENT, KNOWN, OWN, PULL, RIM, ROW, UNKNOWNS

FLOOR = 0.04
"""Standard deviation of an edge's position that noise does not explain [px]."""

TUKEY, LEAST_LIMIT = 4.685, 0.5
"""Residual at which a piece's weight reaches zero [robust standard deviations], and the smallest one near the
solution [px]."""

CORRELATION = 1.1
"""Factor on the standard deviation of pieces because neighbouring pixels share errors, unless each pixel of a
mosaic counts only for the channel that it measured."""

SMEAR = 2.0
"""Blur at which neighbouring pieces have twice the variance because they share errors [px]."""

GAUSSIAN = 1.4826
"""Standard deviation of a normal distribution relative to its median absolute deviation."""

DEVIATION_STD = 0.13
"""Standard deviation of a camera's response exponent around the shared one."""

MODEL_STD = 1e-4
"""Errors that do not average out over samples: edge lengths, unmodelled optics [radii of the object, rad]."""


@compiled
def tukey(residual, limit):  # type: ignore[no-untyped-def]
    """Tukey's biweight of a residual: 1 at zero, 0 from `limit` on."""
    if abs(residual) >= limit:
        return 0.0
    return (1.0 - (residual / limit) ** 2) ** 2


@compiled
def robust_std(residuals, n):  # type: ignore[no-untyped-def]
    """Robust standard deviation of the first n absolute residuals, which are reordered; 1 if there are none.

    The median of all, unlike the mean square of inliers, does not shrink when outliers are left out.
    """
    return GAUSSIAN * median(residuals, n) if n > 0 else 1.0


@compiled
def residual(strip, found, since, exponent, rim):  # type: ignore[no-untyped-def]
    """Remaining offset of an edge [px]: equation (13) of docs/how-it-works.md.

    since (6,): motion of the pose since it was measured.
    """
    left = found.offset - exponent * found.bloom - rim * strip.rim
    for i in range(6):
        left -= strip.jacobian[i] * since[i]
    return left


@compiled
def trust_of(camera):  # type: ignore[no-untyped-def]
    """Factor on the weight of pieces, since neighbours share errors; the edge's own offset is exempt."""
    shared = 1.0 if camera.parts > 1 else 1.0 / CORRELATION**2
    return shared / (1.0 + (camera.blur / (SMEAR * camera.scale)) ** 4)


@compiled
def shown(solution, camera):  # type: ignore[no-untyped-def]
    """Exponent and rim with which a camera shows the object."""
    return solution.shared[EXPONENT] + camera.offset[EXPONENT], solution.shared[RIM]


@compiled
def accumulate(strips, found, camera, since, drawn, least, scatter, seen):  # type: ignore[no-untyped-def]
    """Fill a camera's sums `whole`, `force` and `edges` from its strips' weighted offsets, and count them.

    Weights are those of equation (14) of docs/how-it-works.md.
    since (6,): motion since they were measured; drawn: exponent and rim; least: smallest residual at which a
    weight reaches zero, scatter: of the residuals [px at reference size].
    """
    limit = min(max(least, TUKEY * scatter) * camera.scale, camera.reach)
    floor, trust = (max(FLOOR, 0.7 * scatter) * camera.scale) ** 2, trust_of(camera)
    whole, force, edges, row = camera.whole, camera.force, camera.edges, np.empty(UNKNOWNS)
    whole[:, :], force[:], edges[:, :] = 0.0, 0.0, 0.0
    seen.inliers, seen.squares, seen.noise = 0.0, 0.0, 0.0
    for s in range(camera.strips):
        if not found[s].usable:
            continue
        strip = strips[s]
        r = residual(strip, found[s], since, drawn[0], drawn[1])
        robust = tukey(r, limit)
        if robust <= 0.0:
            continue
        seen.inliers += robust
        seen.squares += robust * r * r
        seen.noise += robust * found[s].variance
        weight = trust * robust / (floor + found[s].variance)
        for i in range(6):
            row[i] = strip.jacobian[i]
        row[EXPONENT], row[RIM] = found[s].bloom, strip.rim
        e = strip.edge
        edges[e, KNOWN] += weight
        edges[e, PULL] += weight * r
        for i in range(UNKNOWNS):
            part = weight * row[i]
            force[i] += part * r
            edges[e, ROW + i] += part
            for k in range(i + 1):
                whole[i, k] += part * row[k]


@compiled
def with_edges(cameras, feet, own, foot):  # type: ignore[no-untyped-def]
    """Fill the normal equations, with edges' own offsets of a variance [px² for an object of reference size].

    All pieces of an edge may be off together, because wear, light or print differ from the model; see below
    equation (14) of docs/how-it-works.md. Where feet (12,) is 1, the colours above the edge also end too
    early, by a deviation of variance `foot` [m²]. Return minus twice the log likelihood of the offsets, up to
    terms that do not depend on the edges' own.
    """
    unlikely = 0.0
    for c in range(len(cameras)):
        camera = cameras[c]
        matrix, vector, edges = camera.information, camera.gradient, camera.edges
        for i in range(UNKNOWNS):
            vector[i] = camera.force[i]
            for k in range(i + 1):
                matrix[i, k] = camera.whole[i, k]
        pivots = 1.0
        for e in range(12):
            if edges[e, KNOWN] == 0.0:
                continue
            retracted = feet[e] * edges[e, ROW + RIM] / edges[e, KNOWN]
            variance = own * camera.scale**2 + foot * retracted**2
            pivot = 1.0 + variance * edges[e, KNOWN]
            pivots, held = pivots * pivot, variance / pivot
            unlikely -= edges[e, PULL] ** 2 * held
            for i in range(UNKNOWNS):
                part = edges[e, ROW + i] * held
                vector[i] -= part * edges[e, PULL]
                for k in range(i + 1):
                    matrix[i, k] -= part * edges[e, ROW + k]
        for i in range(UNKNOWNS):
            for k in range(i):
                matrix[k, i] = matrix[i, k]
        unlikely += math.log(pivots)
    return unlikely


@compiled
def _eliminate(camera, share):  # type: ignore[no-untyped-def]
    """Eliminate a camera's own unknowns by forward substitution.

    Filled: lower, reduced, change. Return its part of what `solve` returns: infinite if it cannot be solved,
    NaN if the camera sees nothing, so that its rounding errors do not count.
    """
    information, offset, lower = camera.information, camera.offset, camera.lower
    reduced, change = camera.reduced, camera.change
    blind = True
    for i in range(OWN):
        blind = blind and information[i, i] == 0.0
    scaled, pivots, doubt = 1.0 / share, share**6, 0.0
    for i in range(OWN):
        force, held = camera.gradient[i], 0.0
        if i < 6:
            for k in range(6):
                weight = scaled * camera.weights[i, k]
                held += weight * offset[k]
                lower[i, k] = information[i, k] + weight
        else:
            held = offset[i] / DEVIATION_STD**2
            for k in range(6):
                lower[i, k] = information[i, k]
            lower[i, i] = information[i, i] + 1.0 / DEVIATION_STD**2
        force -= held
        doubt += offset[i] * held
        for j in range(UNKNOWNS):
            reduced[i, j] = information[i, j]
        pivot = lower[i, i]
        for k in range(i):
            total = lower[i, k]
            for m in range(k):
                total -= lower[i, m] * lower[k, m]
            total *= lower[k, k]
            lower[i, k] = total
            force -= total * change[k]
            pivot -= total**2
            for j in range(UNKNOWNS):
                reduced[i, j] -= total * reduced[k, j]
        if not pivot > 0.0:
            return np.inf
        pivots *= pivot
        inverse = 1.0 / math.sqrt(pivot)
        lower[i, i] = inverse
        change[i] = force * inverse
        doubt -= change[i] ** 2
        for j in range(UNKNOWNS):
            reduced[i, j] *= inverse
    return np.nan if blind else doubt + math.log(pivots)


@compiled
def _add(camera, solution):  # type: ignore[no-untyped-def]
    """Add a camera's part to the shared normal equations: known (n, n), lower half, and change (n,).

    Its image is `delay` old: it sees the pose minus the delay times the change of velocity, see equation (26)
    of docs/how-it-works.md.
    """
    known, vector, delay, reduced = solution.known, solution.change, camera.delay, camera.reduced
    for i in range(UNKNOWNS):
        right = camera.gradient[i]
        for m in range(OWN):
            right -= reduced[m, i] * camera.change[m]
        vector[i] += right
        if i < 6 and delay != 0.0:
            vector[UNKNOWNS + i] -= delay * right
        for k in range(i + 1):
            part = camera.information[i, k]
            for m in range(OWN):
                part -= reduced[m, i] * reduced[m, k]
            known[i, k] += part
            if delay == 0.0:
                continue
            if k < 6:
                known[UNKNOWNS + k, i] -= delay * part
            if i < 6:
                known[UNKNOWNS + i, UNKNOWNS + k] += delay**2 * part
            if k < i < 6:
                known[UNKNOWNS + i, k] -= delay * part


@compiled
def solve(solution, cameras, share):  # type: ignore[no-untyped-def]
    """Solve for the shared unknowns, with the cameras' own eliminated.

    Return minus twice the log likelihood of the measurements with this `share`, up to a constant; infinite if
    the equations cannot be solved: equation (18) of docs/how-it-works.md. The step is equation (17) of
    docs/how-it-works.md, which minimises equation (16) of docs/how-it-works.md.

    Each camera sees the object moved by its own offset η_c, caused by its calibration error, whose inverse
    covariance is `weights` / share. It contributes normal equations `information`, `gradient` at the pose
    moved by η_c. The step minimises
    Σ ‖r_c - J_c (δ - d_c ν + (dη_c, 0))‖² + (η_c + dη_c)ᵀ W_c / share (η_c + dη_c) + δᵀ P δ - 2 δᵀ q with the
    prior P (n, n) and the pull q (n,); with lagging cameras the change of velocity ν is unknown, too.
    Filled: known, lower, and change up to the forward substitution, for `finish`.
    """
    n, known, lower, vector = solution.size, solution.known, solution.lower, solution.change
    doubt, pivots = 0.0, 1.0
    for i in range(n):
        vector[i] = solution.pull[i]
        for k in range(i + 1):
            known[i, k] = solution.prior[i, k]
    for c in range(len(cameras)):
        part = _eliminate(cameras[c], share)
        if part == np.inf:
            return np.inf
        if not math.isnan(part):
            _add(cameras[c], solution)
            doubt += part
    inverse = np.empty(n)
    for i in range(n):
        pivot, force = known[i, i], vector[i]
        for k in range(i):
            total = known[i, k]
            for m in range(k):
                total -= lower[i, m] * lower[k, m]
            lower[i, k] = total * inverse[k]
            pivot -= lower[i, k] ** 2
            force -= lower[i, k] * vector[k]
        if not pivot > 0.0:
            return np.inf
        pivots *= pivot
        lower[i, i] = math.sqrt(pivot)
        inverse[i] = 1.0 / lower[i, i]
        vector[i] = force * inverse[i]
        doubt -= vector[i] ** 2
    doubt += math.log(pivots)
    return doubt if math.isfinite(doubt) else np.inf


@compiled
def finish(solution):  # type: ignore[no-untyped-def]
    """Back-substitute what `solve` left in `change`, and fill the upper half of `known`."""
    n, known, lower, vector = solution.size, solution.known, solution.lower, solution.change
    for i in range(n - 1, -1, -1):
        total = vector[i]
        for k in range(i + 1, n):
            total -= lower[k, i] * vector[k]
        vector[i] = total / lower[i, i]
        for k in range(i):
            known[k, i] = known[i, k]


@compiled
def own_changes(solution, cameras):  # type: ignore[no-untyped-def]
    """Update the cameras' own unknowns after the shared ones."""
    shared = np.empty(UNKNOWNS)
    for c in range(len(cameras)):
        camera = cameras[c]
        for k in range(UNKNOWNS):
            shared[k] = solution.change[k]
            if k < 6:
                shared[k] -= camera.delay * solution.change[UNKNOWNS + k]
        for i in range(OWN - 1, -1, -1):
            total = camera.change[i]
            for k in range(UNKNOWNS):
                total -= camera.reduced[i, k] * shared[k]
            for k in range(i + 1, OWN):
                total -= camera.lower[k, i] * camera.change[k]
            camera.change[i] = total * camera.lower[i, i]


@compiled
def marginal(solution):  # type: ignore[no-untyped-def]
    """Fill the marginal covariance (6, 6) of the pose and the variance of the rim.

    Return False if there is none.

    See equation (19) of docs/how-it-works.md.
    """
    n = solution.size
    lower, inverse = np.zeros((n, n)), np.empty((n, n))
    if not factorise(solution.known, lower):
        return False
    invert(lower, inverse)
    for i in range(6):
        for k in range(i + 1):
            solution.covariance[i, k] = solution.covariance[k, i] = inverse[i, k]
    solution.rim = inverse[RIM, RIM]
    return True


@compiled
def offset_weights(calibration, position, out):  # type: ignore[no-untyped-def]
    """Fill out (6, 6): inverse covariance of the offset that a camera's calibration error causes [m, rad].

    This is equation (15) of docs/how-it-works.md.
    An error (δt, ω) of camera_from_world moves a point in the camera by δt + ω × (R P). An object at
    `position` would look the same if it had moved by δp + δθ × (P - position) along world axes, with δθ = Rᵀω
    and δp = Rᵀδt + δθ × position. calibration (6, 6) is the inverse of
    `calibration.deviations.calibration_covariance`.
    """
    back, x, y, z = np.eye(6), position[0], position[1], position[2]
    back[4, 0], back[5, 0], back[3, 1] = -z, y, z
    back[5, 1], back[3, 2], back[4, 2] = -x, -y, x
    out[:, :] = 0.0
    congruence(back, calibration, out)


@compiled
def add_model_errors(covariance, radius):  # type: ignore[no-untyped-def]
    """Add to a pose's covariance (6, 6) errors that do not average out; radius: of the object [m].

    This is equation (19) of docs/how-it-works.md.
    """
    for i in range(6):
        covariance[i, i] += MODEL_STD**2 * (radius**2 if i < 3 else 1.0)
