"""The normal equations of everything that is unknown at once, and their solution.

Unknown are the pose (6), the exponent of the cameras' response and the rim of the object's edges, which all
cameras share; for each camera an offset of the pose (6), which its calibration error causes, and its own
deviation of the exponent, which act as the first seven of what is shared; and of each edge in each camera an
offset of its own. What is the edges' and the cameras' own is eliminated.
"""

from __future__ import annotations

import math

import numpy as np

from tracker.compiled import compiled
from tracker.conventions import FloatArray
from tracker.geometry.linear import factorise, median, substitute

EXPONENT, RIM = 6, 7
UNKNOWNS = 8
"""Pose, exponent and rim."""

MOVING = UNKNOWNS + 6
"""Where cameras lag behind, the object's velocity is unknown, too: its change from what is expected."""

OWN = 7
"""Of each camera: the offset of the pose, and how much its exponent deviates from that of all."""

KNOWN, PULL, ROW = 0, 1, 2
EDGE = ROW + UNKNOWNS
"""Of each edge: sums over its strips of weights, weighted offsets, and weighted motion with the unknowns."""

ROWS = 5
"""Of what a table tells: height and two tilts of the face that is nearly below; height and slope of the
lowest edge."""

CAMERA = np.dtype(
    [
        ("used", np.bool_),  # whether there is a picture
        ("parts", np.int64),  # 3 where each pixel of a mosaic counts for one channel, else 1
        ("scale", np.float64),  # size of the object in the picture over the reference
        ("delay", np.float64),  # by which the picture is older than others [s]
        ("weights", np.float64, (6, 6)),  # inverse covariance of its offset, as its calibration states it
        ("offset", np.float64, (OWN,)),  # by which it sees the object moved [m, rad], and of its exponent
        ("lag", np.float64, (6,)),  # by which it sees it moved since its picture is older [m, rad]
        ("blur", np.float64),  # of its picture's steps [px]
        ("reach", np.float64),  # half width of the strips [px]
        ("strips", np.int64),  # how many
        ("motion", np.float64, (6,)),  # of the pose as it sees it since the strips were collected, and …
        ("since", np.float64, (6,)),  # … since their offsets were measured [m, rad]
        ("edges", np.float64, (12, EDGE)),  # sums over each edge's strips
        ("whole", np.float64, (UNKNOWNS, UNKNOWNS)),  # normal equations without edges' own offsets, and …
        ("force", np.float64, (UNKNOWNS,)),  # … their right side
        ("information", np.float64, (UNKNOWNS, UNKNOWNS)),  # normal equations, and …
        ("gradient", np.float64, (UNKNOWNS,)),  # … their right side
        ("lower", np.float64, (OWN, OWN)),  # factor of what is its own, the pivots' inverse on the diagonal
        ("reduced", np.float64, (OWN, UNKNOWNS)),  # of its own by what is shared, forward substituted, and …
        ("change", np.float64, (OWN,)),  # … where what is shared stays; after `own_changes` its update
    ]
)
"""One camera's part in the solution."""

SOLUTION = np.dtype(
    [
        ("size", np.int64),  # n, how many unknowns are shared: UNKNOWNS, or MOVING
        ("rotation", np.float64, (3, 3)),  # world_from_object
        ("position", np.float64, (3,)),  # [m]
        ("shared", np.float64, (MOVING,)),  # exponent, rim, change of velocity; the pose's are not used
        ("own", np.float64),  # variance of edges' own offsets [px² of an object of reference size]
        ("prior", np.float64, (MOVING, MOVING)),  # information that there was before, and …
        ("pull", np.float64, (MOVING,)),  # … its right side
        ("known", np.float64, (MOVING, MOVING)),  # information with all else marginalised
        ("lower", np.float64, (MOVING, MOVING)),  # its Cholesky factor
        ("change", np.float64, (MOVING,)),  # update of what is shared
        ("columns", np.float64, (MOVING, ROWS)),  # how the table's say depends on it, and …
        ("less", np.float64, (ROWS, ROWS)),  # … how much less uncertain that makes it
        ("covariance", np.float64, (6, 6)),  # of the pose [m, rad]
        ("stands", np.float64),  # how well it stands: log odds over an object that may be anywhere
        ("converged", np.bool_),  # whether the last step was negligible
        ("steps", np.int64),  # how many there were
    ]
)
"""What all cameras share in the solution."""

GAUSSIAN = 1.4826
"""Standard deviation of a normal distribution over its median deviation."""

DEVIATION_STD = 0.13
"""Standard deviation of a camera's exponent of response around that of all."""

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

MODEL_STD = 4e-4, 3e-4
"""What no number of samples averages away: edge lengths, unmodelled optics [radii of the object, rad]."""


@compiled(inline="always")
def tukey(residual, limit):  # type: ignore[no-untyped-def]
    """Tukey's biweight of a residual: 1 at zero, 0 from `limit` on."""
    if abs(residual) >= limit:
        return 0.0
    return (1.0 - (residual / limit) ** 2) ** 2


@compiled
def spread(residuals, n):  # type: ignore[no-untyped-def]
    """Robust standard deviation of the first n absolute residuals, whose order changes; 1 of none.

    The median of all, unlike the inliers' mean square, does not shrink by leaving out what disagrees.
    """
    return GAUSSIAN * median(residuals, n) if n > 0 else 1.0


@compiled(inline="always")
def residual(strip, found, since, exponent, rim):  # type: ignore[no-untyped-def]
    """Offset of an edge [px] that is left: equation (13) of docs/how-it-works.md.

    since (6,): motion of the pose since it was measured.
    """
    left = found.offset - exponent * found.bloom - rim * strip.rim
    for i in range(6):
        left -= strip.jacobian[i] * since[i]
    return left


@compiled
def accumulate(strips, found, camera, since, drawn, weighing, seen):  # type: ignore[no-untyped-def]
    """Fill a camera's sums `whole`, `force` and `edges` with its strips' weighted offsets, and count them.

    Weights are those of equation (14) of docs/how-it-works.md.
    since (6,): motion since they were measured; drawn: exponent and rim; weighing: residual [px] at which a
    weight reaches zero, variance of an edge's place [px²] that noise does not explain, factor on all weights.
    """
    limit, floor, trust = weighing
    whole, force, edges, row = camera.whole, camera.force, camera.edges, np.empty(UNKNOWNS)
    for i in range(UNKNOWNS):
        force[i] = 0.0
        for k in range(UNKNOWNS):
            whole[i, k] = 0.0
    for e in range(12):
        for i in range(EDGE):
            edges[e, i] = 0.0
    seen.inliers, seen.squares = 0.0, 0.0
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
            for k in range(UNKNOWNS):
                whole[i, k] += part * row[k]


@compiled
def with_edges(cameras, own):  # type: ignore[no-untyped-def]
    """Fill the normal equations for edges' own offsets of a variance [px² of an object of reference size].

    All pieces of an edge may be off together, since it is worn, lit, or printed otherwise than the model has
    it; see below equation (14) of docs/how-it-works.md. Returns minus twice the logarithm of the offsets'
    likelihood as far as it depends on the edges' own.
    """
    unlikely = 0.0
    for c in range(len(cameras)):
        camera = cameras[c]
        matrix, vector, edges = camera.information, camera.gradient, camera.edges
        for i in range(UNKNOWNS):
            vector[i] = camera.force[i]
            for k in range(UNKNOWNS):
                matrix[i, k] = camera.whole[i, k]
        if not camera.used:
            continue
        variance, pivots = own * camera.scale**2, 1.0
        for e in range(12):
            if edges[e, KNOWN] == 0.0:
                continue
            pull = edges[e, PULL] / (edges[e, KNOWN] + 1.0 / variance)
            pivots *= 1.0 + variance * edges[e, KNOWN]
            unlikely -= edges[e, PULL] * pull
            for i in range(UNKNOWNS):
                part = edges[e, ROW + i] / (edges[e, KNOWN] + 1.0 / variance)
                vector[i] -= part * edges[e, PULL]
                for k in range(UNKNOWNS):
                    matrix[i, k] -= part * edges[e, ROW + k]
        unlikely += math.log(pivots)
    return unlikely


@compiled
def _eliminate(camera, share):  # type: ignore[no-untyped-def]
    """Forward substitute what is a camera's own by what is shared.

    Filled: lower, reduced, change. Returns its part of the doubt, see `solve`; infinite where it cannot be
    solved, and NaN where the camera sees nothing, so that rounding does not have it say something.
    """
    information, offset, lower = camera.information, camera.offset, camera.lower
    reduced, change = camera.reduced, camera.change
    blind = True
    for i in range(OWN):
        blind = blind and information[i, i] == 0.0
    if blind:
        return np.nan
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
        for k in range(i):
            total = lower[i, k]
            for m in range(k):
                total -= lower[i, m] * lower[k, m]
            total *= lower[k, k]
            lower[i, k] = total
            force -= total * change[k]
            for j in range(UNKNOWNS):
                reduced[i, j] -= total * reduced[k, j]
        pivot = lower[i, i]
        for k in range(i):
            pivot -= lower[i, k] ** 2
        if not pivot > 0.0:
            return np.inf
        pivots *= pivot
        inverse = 1.0 / math.sqrt(pivot)
        lower[i, i] = inverse
        change[i] = force * inverse
        doubt -= change[i] ** 2
        for j in range(UNKNOWNS):
            reduced[i, j] *= inverse
    return doubt + math.log(pivots)


@compiled
def _add(camera, solution):  # type: ignore[no-untyped-def]
    """Add what a camera says of what is shared to known (n, n), lower half, and change (n,).

    Its picture is `delay` old: it sees the pose less the delay times the change of velocity, see
    equation (26) of docs/how-it-works.md.
    """
    known, vector, delay = solution.known, solution.change, camera.delay
    row = np.empty(UNKNOWNS)
    for i in range(UNKNOWNS):
        right = camera.gradient[i]
        for k in range(UNKNOWNS):
            row[k] = camera.information[i, k]
        for m in range(OWN):
            part = camera.reduced[m, i]
            right -= part * camera.change[m]
            for k in range(UNKNOWNS):
                row[k] -= part * camera.reduced[m, k]
        vector[i] += right
        for k in range(i + 1):
            known[i, k] += row[k]
        if delay == 0.0:
            continue
        if i < 6:
            vector[UNKNOWNS + i] -= delay * right
            for k in range(i + 1):
                known[UNKNOWNS + i, UNKNOWNS + k] += delay**2 * row[k]
        for k in range(6):
            known[UNKNOWNS + k, i] -= delay * row[k]


@compiled
def solve(solution, cameras, share):  # type: ignore[no-untyped-def]
    """Solve for what is shared, whatever the cameras have of their own.

    Returns minus twice the logarithm of the measurements' likelihood under this `share`, up to a constant;
    infinite, where the equations cannot be solved: equation (18) of docs/how-it-works.md. The step is
    equation (17) of docs/how-it-works.md, which minimises equation (16) of docs/how-it-works.md.

    Each camera sees the object moved by an offset η_c of its own, which its calibration error causes and
    whose inverse covariance is `weights` over share. It contributes the normal equations `information`,
    `gradient` at the pose moved by η_c. Minimised is
    Σ ‖r_c - J_c (δ - d_c ν + (dη_c, 0))‖² + (η_c + dη_c)ᵀ W_c / share (η_c + dη_c) + δᵀ P δ - 2 δᵀ q with
    prior P (n, n) and pull q (n,); where cameras lag behind, the change of velocity ν is unknown, too.
    Filled: known, lower, and change as far as forward substitution leads, until `finish`.
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
    for i in range(n):
        for k in range(i + 1):
            total = known[i, k]
            for m in range(k):
                total -= lower[i, m] * lower[k, m]
            if k < i:
                lower[i, k] = total / lower[k, k]
            elif total > 0.0:
                lower[i, i] = math.sqrt(total)
                pivots *= total
            else:
                return np.inf
        total = vector[i]
        for k in range(i):
            total -= lower[i, k] * vector[k]
        vector[i] = total / lower[i, i]
        doubt -= vector[i] ** 2
    doubt += math.log(pivots)
    return doubt if math.isfinite(doubt) else np.inf


@compiled
def finish(solution):  # type: ignore[no-untyped-def]
    """Substitute backwards what `solve` left in `change`, and fill the upper half of `known`."""
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
    """Let what is the cameras' own follow the update of what is shared."""
    shared = np.empty(UNKNOWNS)
    for c in range(len(cameras)):
        camera = cameras[c]
        blind = True
        for i in range(OWN):
            blind = blind and camera.information[i, i] == 0.0
        for k in range(UNKNOWNS):
            shared[k] = solution.change[k]
            if k < 6 and solution.size > UNKNOWNS:
                shared[k] -= camera.delay * solution.change[UNKNOWNS + k]
        for i in range(OWN - 1, -1, -1):
            if blind:
                # It goes back to its calibration.
                camera.change[i] = -camera.offset[i]
                continue
            total = camera.change[i]
            for k in range(UNKNOWNS):
                total -= camera.reduced[i, k] * shared[k]
            for k in range(i + 1, OWN):
                total -= camera.lower[k, i] * camera.change[k]
            camera.change[i] = total * camera.lower[i, i]


@compiled
def marginal(solution):  # type: ignore[no-untyped-def]
    """Fill covariance (6, 6) of the pose where all else is unknown; False where there is none.

    See equation (19) of docs/how-it-works.md.
    """
    n = solution.size
    known, lower, column = np.empty((n, n)), np.zeros((n, n)), np.empty(n)
    for i in range(n):
        for k in range(n):
            known[i, k] = solution.known[i, k]
    if not factorise(known, lower):
        return False
    for k in range(6):
        column[:] = 0.0
        column[k] = 1.0
        substitute(lower, column, column)
        for i in range(6):
            solution.covariance[i, k] = column[i]
    return True


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


@compiled
def offset_weights(calibration, position, out):  # type: ignore[no-untyped-def]
    """Out (6, 6): inverse covariance of the offset [m, rad] that a camera's calibration error causes.

    This is equation (15) of docs/how-it-works.md.
    An error (δt, ω) of camera_from_world moves a point in the camera by δt + ω × (R P), which is what
    an object at `position` would show if it had moved by δp + δθ × (P - position) along world axes, with
    δθ = Rᵀω and δp = Rᵀδt + δθ × position. calibration (6, 6) is the inverse of
    `calibration.deviations.calibration_covariance`.
    """
    back = np.eye(6)
    x, y, z = position[0], position[1], position[2]
    back[0, 4], back[0, 5], back[1, 3] = -z, y, z
    back[1, 5], back[2, 3], back[2, 4] = -x, -y, x
    for i in range(6):
        for j in range(6):
            total = 0.0
            for k in range(6):
                for m in range(6):
                    total += back[k, i] * calibration[k, m] * back[m, j]
            out[i, j] = total


def with_model_errors(covariance: FloatArray, radius: float) -> FloatArray:
    """The covariance (6, 6) of a pose with what no number of samples averages away; radius: of the object.

    This is equation (19) of docs/how-it-works.md.
    """
    result: FloatArray = 0.5 * (covariance + covariance.T)
    diagonal = result.ravel()[::7]
    diagonal[:3] += (MODEL_STD[0] * radius) ** 2
    diagonal[3:] += MODEL_STD[1] ** 2
    return result
