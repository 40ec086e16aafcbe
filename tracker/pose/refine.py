"""Refine a pose on the images' edges: measure, weigh, solve, move."""

import math

import numpy as np

from tracker.compiled import compiled
from tracker.geometry.lens import apply_update, copy_pose, may_see
from tracker.geometry.linear import factorise, invert, median
from tracker.pose.align import FEWEST_PIECES
from tracker.pose.edge_fit import measure
from tracker.pose.fit import LIKELY
from tracker.pose.own_view import see_alone
from tracker.pose.scale import relative_size
from tracker.pose.sizes import sizes
from tracker.pose.solution import EXPONENT, MOVING, RIM, UNKNOWNS
from tracker.pose.solve import (
    accumulate,
    add_model_errors,
    finish,
    marginal,
    offset_weights,
    own_changes,
    residual,
    robust_std,
    shown,
    solve,
    with_edges,
)
from tracker.pose.strips import collect, edge_strips
from tracker.pose.support import apply_table, mark_feet, reduce_by_table
from tracker.pose.views import mask_of, pixels_of

# Lengths in pixels are for an object of reference size (`scale`), unless stated otherwise.

REACH = 1.2, 2.0
"""Half width of the strips along the edges: constant part [px] and factor on the blur."""

LEAST_REACH = 2.5
"""Smallest half width [px of the image]."""

MARGIN = 0.4, 1.5
"""Distance of pieces from corners, where three surfaces mix: constant part [px] and factor on the blur."""

EXPECTED_WEAR = 0.05
"""Prior standard deviation of the offset common to all pieces of an edge [px]."""

BLURS = 0.5, 3.0
"""Bounds of the blur: smallest [px of the image], largest [px]."""

LONGEST = 0.4
"""Longest step, in position [radii of the object] and rotation [rad]: strips see nothing farther away."""

STRAY = 0.15
"""Motion of a strip beyond which its pixels are collected again [half widths]."""

ROUNDS = 2
"""Reweighted solutions per measurement of the offsets."""

EXPONENT_STD = 0.5
"""Prior standard deviation of the response's exponent."""

FINE_MOSAIC = 1.5
"""Size of the object relative to the reference, above which a mosaic does not matter: strips have so many
pixels that interpolation errors average out (modelling it does not help recorded images of 540×540)."""

PRIOR = 3.0, 10.0
"""Information of a prior of 0.6 radii of the object and 0.3 rad around the pose before each step, which
constrains unobserved directions; positions in units of the radius."""


@compiled
def begin(model, pictures, solution, cameras, start):  # type: ignore[no-untyped-def]
    """Set up the priors at the pose of a solution; return whether the calibration states errors.

    start: see Start.
    """
    radius2 = model.half[0] ** 2 + model.half[1] ** 2 + model.half[2] ** 2
    for i in range(6):
        solution.prior[i, i] = PRIOR[0] / radius2 if i < 3 else PRIOR[1]
    solution.prior[EXPONENT, EXPONENT] = 1.0 / EXPONENT_STD**2
    solution.prior[RIM, RIM] = 1.0 / start.rim_std**2
    if solution.size == MOVING:
        lower = np.zeros((6, 6))
        factorise(solution.velocity, lower)
        invert(lower, solution.prior[UNKNOWNS:, UNKNOWNS:])
    solution.covariance[:, :] = np.nan
    solution.shared[EXPONENT], solution.shared[RIM] = start.exponent, start.rim
    solution.own, doubtful = EXPECTED_WEAR**2, False
    position = np.empty(3)
    for c in range(len(cameras)):
        camera = cameras[c]
        for i in range(3):
            position[i] = solution.position[i] + camera.lag[i]
        # A camera that looks elsewhere neither agrees nor disagrees.
        camera.used = pictures[c].used and may_see(model.lenses, c, position, math.sqrt(radius2))
        camera.scale = relative_size(model.lenses, c, model.half, solution.position)
        camera.parts = 3 if pictures[c].mosaic >= 0 and camera.scale < FINE_MOSAIC else 1
        camera.blur = start.blur * camera.scale
        offset_weights(model.calibration[c], solution.position, camera.weights)
        doubtful = doubtful or (camera.used and model.stated[c])
        length = 0.0
        for i in range(3):
            camera.sight[i] = model.lenses[c].position[i] - solution.position[i]
            length += camera.sight[i] ** 2
        for i in range(3):
            camera.sight[i] /= math.sqrt(length)
    return doubtful


@compiled
def _lay_strips(model, solution, cameras, schedule, step, work):  # type: ignore[no-untyped-def]
    """Lay strips along the edges at the current pose, as a step of the schedule requires."""
    mark_feet(model.table, model.half, solution)
    rotation, position = np.empty((3, 3)), np.empty(3)
    for c in range(len(cameras)):
        camera = cameras[c]
        camera.strips, camera.every, camera.pixels = 0, 0, 0
        camera.motion[:] = 0.0
        if not camera.used:
            continue
        scale = camera.scale
        blur = schedule.blur[step] * scale if schedule.blur[step] > 0.0 else camera.blur
        camera.reach = max(LEAST_REACH, REACH[0] * scale + REACH[1] * blur)
        moved = np.empty(6)
        for i in range(6):
            moved[i] = camera.offset[i] + camera.lag[i]
        copy_pose(solution.rotation, solution.position, rotation, position)
        apply_update(rotation, position, moved)
        camera.strips = edge_strips(
            model.lenses, c, model.half, model.face_labels, rotation, position, schedule.piece[step] * scale,
            MARGIN[0] * scale + MARGIN[1] * blur, work.strips[c],
        )  # fmt: skip


@compiled
def _measure_all(model, pictures, cameras, schedule, step, work):  # type: ignore[no-untyped-def]
    """Measure the offsets of all strips at the current pose."""
    for c in range(len(cameras)):
        camera, every, pixels = cameras[c], schedule.every[step], (work.distance[c], work.values[c])
        camera.since[:] = 0.0
        if camera.every != every:
            shown = pixels_of(pictures[c]), mask_of(pictures[c])
            collect(shown, pictures[c], camera, work.strips[c], every, pixels)
        rough = schedule.blur[step] * camera.scale
        measure(
            work.strips[c], camera, pictures[c].channels, model.colors,
            rough if rough > 0.0 else camera.blur, every, pixels, work.scratch, work.found[c],
        )  # fmt: skip


@compiled
def _estimate_blurs(solution, cameras, likely, work, seen):  # type: ignore[no-untyped-def]
    """Count the strips and estimate the blurs; return the residuals' robust standard deviation [px].

    likely: blur of an image if it cannot be measured in any [px at reference size].
    """
    total, knowing, known_blur = 0, 0, 0.0
    for c in range(len(cameras)):
        camera = cameras[c]
        seen[c].expected, seen[c].usable = 0.0, 0.0
        scale, widths, (exponent, rim) = camera.scale, 0, shown(solution, camera)
        for s in range(camera.strips):
            if not work.strips[c, s].in_view or s % camera.every:
                continue
            seen[c].expected += 1.0
            found = work.found[c, s]
            if not found.usable:
                continue
            seen[c].usable += 1.0
            off = abs(residual(work.strips[c, s], found, camera.since, exponent, rim)) / scale
            work.residuals[total] = off
            total += 1
            if off < 1.0 and found.sharpness > 0.0:
                work.widths[widths] = found.wider
                widths += 1
        if widths >= FEWEST_PIECES:
            wider = min(scale, max(-0.6 * camera.blur, median(work.widths, widths)))
            camera.blur = min(max(camera.blur + wider, BLURS[0]), max(BLURS[1] * scale, BLURS[0]))
            known_blur += camera.blur / scale
            knowing += 1
        else:
            camera.blur = 0.0
    for c in range(len(cameras)):
        # A camera that shows only narrow faces takes its blur from the others.
        if cameras[c].blur == 0.0:
            cameras[c].blur = cameras[c].scale * (known_blur / knowing if knowing > 0 else likely)
        seen[c].blur = cameras[c].blur
    return robust_std(work.residuals, total)


@compiled
def _weigh(solution, cameras, least, scatter, work, seen):  # type: ignore[no-untyped-def]
    """Accumulate every camera's strips; least: smallest Tukey limit [px]; scatter: of the residuals [px]."""
    for c in range(len(cameras)):
        camera, drawn = cameras[c], shown(solution, cameras[c])
        accumulate(work.strips[c], work.found[c], camera, camera.since, drawn, least, scatter, seen[c])


@compiled
def _pull(solution, start):  # type: ignore[no-untyped-def]
    """Pull the shared unknowns other than the pose towards their priors."""
    n, shared = solution.size, solution.shared
    solution.pull[EXPONENT] = (LIKELY.exponent - shared[EXPONENT]) / EXPONENT_STD**2
    solution.pull[RIM] = (start.rim - shared[RIM]) / start.rim_std**2
    for i in range(UNKNOWNS, n):
        solution.pull[i] = 0.0
        for k in range(UNKNOWNS, n):
            solution.pull[i] -= solution.prior[i, k] * shared[k]


@compiled
def _move(solution, cameras, radius):  # type: ignore[no-untyped-def]
    """Apply a step, shortened if it is too long; radius: of the object [m]."""
    change = solution.change
    shift = math.sqrt(change[0] ** 2 + change[1] ** 2 + change[2] ** 2)
    turn = math.sqrt(change[3] ** 2 + change[4] ** 2 + change[5] ** 2)
    share = 1.0 / max(shift / (LONGEST * radius), turn / LONGEST, 1.0)
    part = np.empty(6)
    for i in range(6):
        part[i] = change[i] * share
        solution.moved[i] += part[i]
    apply_update(solution.rotation, solution.position, part)
    for i in range(6, solution.size):
        solution.shared[i] += change[i] * share
    for c in range(len(cameras)):
        camera = cameras[c]
        camera.offset[EXPONENT] += camera.change[EXPONENT] * share
        for i in range(6):
            camera.offset[i] += camera.change[i] * share
            lag = camera.delay * change[UNKNOWNS + i] * share
            camera.lag[i] -= lag
            moved = part[i] + camera.change[i] * share - lag
            camera.motion[i] += moved
            camera.since[i] += moved


@compiled
def _length(solution):  # type: ignore[no-untyped-def]
    """Squared length of the motion since the offsets were measured [standard deviations]."""
    size = 0.0
    for i in range(6):
        for k in range(6):
            size += solution.moved[i] * solution.known[i, k] * solution.moved[k]
    return size


@compiled
def _moved_out(cameras, work):  # type: ignore[no-untyped-def]
    """Whether a strip has moved by more than STRAY half widths since it was collected."""
    for c in range(len(cameras)):
        for s in range(cameras[c].strips):
            shift = 0.0
            for i in range(6):
                shift += work.strips[c, s].jacobian[i] * cameras[c].motion[i]
            if abs(shift) > STRAY * cameras[c].reach:
                return True
    return False


@compiled
def _approach(model, pictures, schedule, start, solution, cameras, seen, work):  # type: ignore[no-untyped-def]
    """Move the pose of a solution in place; arguments as in `refine`.

    Gauss-Newton on the pose and on an offset η_c per camera, which sees the object at the pose moved by η_c;
    the calibration's stated errors constrain the offsets.
    """
    doubtful = begin(model, pictures, solution, cameras, start)
    radius = math.sqrt(model.half[0] ** 2 + model.half[1] ** 2 + model.half[2] ** 2)
    share, step, stray, late = 1.0, 0, True, False
    while step < len(schedule.blur) and not solution.converged:
        if stray:
            _lay_strips(model, solution, cameras, schedule, step, work)
        _measure_all(model, pictures, cameras, schedule, step, work)
        solution.moved[:] = 0.0
        scatter = _estimate_blurs(solution, cameras, start.blur, work, seen)
        if not schedule.moves:
            step, stray = step + 1, False
            continue
        rough = schedule.blur[step] > 0.0
        # Only after a step without extra blur do the cameras agree. Before that, the table would hold the
        # pose away from where they see it, and residuals would not be due to the edges alone.
        late = step > 0 and schedule.blur[step - 1] == 0.0
        for turn in range(ROUNDS):
            _pull(solution, start)
            _weigh(solution, cameras, schedule.tukey[step], scatter, work, seen)
            if turn == 0 and not rough:
                share = sizes(solution, cameras, doubtful, late)
            with_edges(cameras, solution.feet, solution.own, solution.foot)
            if not np.isfinite(solve(solution, cameras, share)):
                return
            finish(solution)
            if model.table.known and late:
                solution.stands = apply_table(model.table, model.half, solution)
            own_changes(solution, cameras)
            _move(solution, cameras, radius)
        solution.converged = late and _length(solution) < schedule.negligible[step]
        step += 1
        stray = rough or (not solution.converged and _moved_out(cameras, work))
    if not (schedule.moves and marginal(solution)):
        solution.converged = False
    elif model.table.known and late:
        reduce_by_table(solution)
    add_model_errors(solution.covariance, radius)


@compiled
def refine(model, pictures, schedule, start, solution, cameras, seen, work, own):  # type: ignore[no-untyped-def]
    """Move the pose of a solution in place to where it fits the images' edges best.

    Args:
        model: see `refiner.Model`.
        pictures: (C,) of PICTURE.
        schedule: see `schedule.Schedule`.
        start: see Start.
        solution: (1,) of SOLUTION, filled; its pose is the initial one.
        cameras: (C,) of CAMERA, filled; delay and lag are given.
        seen: (C,) of SEEN, filled except for label counts.
        work: see `refiner.Workspace`.
        own: OwnViews of all cameras, filled; of length 0: not estimated.
    """
    _approach(model, pictures, schedule, start, solution[0], cameras, seen, work)
    if len(own.inliers) > 0:
        see_alone(solution[0], cameras, work, own)
    count = 0
    for c in range(len(cameras)):
        camera = cameras[c]
        seen[c].squares /= camera.scale**2
        seen[c].noise /= camera.scale**2
        if camera.used:
            work.residuals[count] = camera.blur / camera.scale
            count += 1
    solution[0].blur = median(work.residuals, count) if count > 0 else start.blur
