"""The refinement's loop over strips that were collected: measure, weigh, solve, move."""

from __future__ import annotations

import math

import numpy as np

from tracker.compiled import compiled
from tracker.geometry.lens import apply_update
from tracker.geometry.linear import median
from tracker.pose.edges.offset import Palette, measure
from tracker.pose.solve.normal import accumulate, residual
from tracker.pose.solve.robust import spread
from tracker.pose.solve.sizes import sizes, with_edges
from tracker.pose.solve.step import (
    EXPONENT,
    RIM,
    UNKNOWNS,
    blank_step,
    marginal,
    own_changes,
    solve_step,
)
from tracker.pose.solve.support import ROWS, lean, leaner
from tracker.pose.start import LIKELY

NOISE = 1.5
"""Least standard deviation of a pixel's channel [levels]; what does not fit the model raises it."""

MIN_WIDTHS = 4
"""Pieces that must show the blur before it is believed."""

EXPONENT_STD = 0.5
"""Standard deviation of the response's exponent."""

STATED = 1e11
"""Inverse variance of a position from which on a calibration states no errors that it could have a share of
(see calibration.deviations.LEAST_VARIANCE)."""


@compiled
def measure_all(cameras, unknowns, schedule, step, work):  # type: ignore[no-untyped-def]
    """Measure the offsets of all strips at the present pose."""
    for c in range(len(cameras.used)):
        if cameras.used[c]:
            rough = schedule.blur[step] * cameras.scales[c]
            measure(
                work.strips[c], work.counts[c], cameras.parts[c], work.motion[c], work.distance[c],
                work.values[c], Palette(cameras.channels[c], cameras.table), work.reaches[c],
                rough if rough > 0.0 else unknowns.blurs[c], NOISE, schedule.every[step], work.scratch,
                work.found[c],
            )  # fmt: skip
    work.since[:] = 0.0


@compiled
def take_stock(cameras, unknowns, tuning, work, seen):  # type: ignore[no-untyped-def]
    """Count the strips and judge the blurs anew; returns how far the residuals scatter [px]."""
    total, knowing, known_blur = 0, 0, 0.0
    for c in range(len(cameras.used)):
        seen[c].expected, seen[c].usable = 0.0, 0.0
        if not cameras.used[c]:
            continue
        scale, widths = cameras.scales[c], 0
        exponent, rim = unknowns.shared[EXPONENT] + unknowns.offsets[c, EXPONENT], unknowns.shared[RIM]
        for s in range(work.counts[c]):
            if not work.strips[c, s].in_view:
                continue
            seen[c].expected += 1.0
            found = work.found[c, s]
            if not found.usable:
                continue
            seen[c].usable += 1.0
            off = abs(residual(work.strips[c, s], found, work.since[c], exponent, rim)) / scale
            work.residuals[total] = off
            total += 1
            if off < 1.0 and found.sharpness > 0.0:
                work.widths[widths] = found.wider
                widths += 1
        if widths >= MIN_WIDTHS:
            wider = min(1.0, max(-0.6 * unknowns.blurs[c], median(work.widths, widths)))
            largest = max(tuning.largest_blur * scale, tuning.least_blur)
            unknowns.blurs[c] = min(max(unknowns.blurs[c] + wider, tuning.least_blur), largest)
            known_blur += unknowns.blurs[c] / scale
            knowing += 1
        else:
            unknowns.blurs[c] = 0.0
    for c in range(len(cameras.used)):
        # A camera that shows narrow faces only takes its blur from the others.
        if unknowns.blurs[c] == 0.0:
            likely = known_blur / knowing if knowing > 0 else cameras.blur
            unknowns.blurs[c] = cameras.scales[c] * likely
        seen[c].blur = unknowns.blurs[c]
    return spread(work.residuals, total)


@compiled(inline="always")
def trust_of(parts, blur, scale, tuning):  # type: ignore[no-untyped-def]
    """What neighbouring pieces share makes their sum, not the edge's own offset, so much less certain.

    parts: 3 where each pixel of a mosaic counts for one channel; blur: [px of the picture]; scale: size of
    the object in it over the reference.
    """
    return (1.0 if parts > 1 else 1.0 / tuning.correlation**2) / (1.0 + (blur / (tuning.smear * scale)) ** 4)


@compiled
def _add_up(cameras, unknowns, tuning, least, scatter, work, seen):  # type: ignore[no-untyped-def]
    """The sums over every camera's strips."""
    limit = max(least, tuning.tukey * scatter)
    for c in range(len(cameras.used)):
        work.whole[c, :, :], work.force[c, :], work.edges[c, :, :] = 0.0, 0.0, 0.0
        seen[c].inliers, seen[c].squares = 0.0, 0.0
        if not cameras.used[c]:
            continue
        scale = cameras.scales[c]
        accumulate(
            work.strips[c], work.found[c], work.counts[c], work.since[c],
            unknowns.shared[EXPONENT] + unknowns.offsets[c, EXPONENT], unknowns.shared[RIM],
            min(limit * scale, work.reaches[c]), (max(tuning.floor, 0.7 * scatter) * scale) ** 2,
            trust_of(cameras.parts[c], unknowns.blurs[c], scale, tuning),
            work.whole[c], work.force[c], seen[c], work.edges[c],
        )  # fmt: skip


@compiled
def _move(cameras, unknowns, update, changes, tuning, radius, work):  # type: ignore[no-untyped-def]
    """Change the unknowns by a step, or by as much of it as is not too long."""
    shift = math.sqrt(update[0] ** 2 + update[1] ** 2 + update[2] ** 2)
    turn = math.sqrt(update[3] ** 2 + update[4] ** 2 + update[5] ** 2)
    limit = max(shift / (tuning.longest * radius), turn / tuning.largest, 1.0)
    part = np.empty(6)
    for i in range(6):
        part[i] = update[i] / limit
    apply_update(unknowns.rotation, unknowns.position, part)
    for i in range(6, len(update)):
        unknowns.shared[i] += update[i] / limit
    for c in range(len(changes)):
        unknowns.offsets[c, EXPONENT] += changes[c, EXPONENT] / limit
        for i in range(6):
            unknowns.offsets[c, i] += changes[c, i] / limit
            moved = (update[i] + changes[c, i]) / limit
            if len(update) > UNKNOWNS:
                lag = cameras.delays[c] * update[UNKNOWNS + i] / limit
                cameras.lags[c, i] -= lag
                moved -= lag
            work.motion[c, i] += moved
            work.since[c, i] += moved


@compiled
def _length(before, unknowns, known):  # type: ignore[no-untyped-def]
    """Squared length of the pose's motion, in standard deviations; before: rotation and position."""
    rotation, position = before
    moved = np.empty(6)
    for i in range(3):
        moved[i] = unknowns.position[i] - position[i]
        # Of a small turn: half of what R Rᵀ is not symmetric by.
        a, b = (i + 1) % 3, (i + 2) % 3
        moved[3 + i] = 0.0
        for k in range(3):
            moved[3 + i] += 0.5 * (
                unknowns.rotation[b, k] * rotation[a, k] - unknowns.rotation[a, k] * rotation[b, k]
            )
    size = 0.0
    for i in range(6):
        for k in range(6):
            size += moved[i] * known[i, k] * moved[k]
    return size


@compiled
def _astray(work, limit):  # type: ignore[no-untyped-def]
    """Whether a strip has moved by more than a share `limit` of its half width since it was collected."""
    for c in range(len(work.counts)):
        for s in range(work.counts[c]):
            shift = 0.0
            for i in range(6):
                shift += work.strips[c, s].jacobian[i] * work.motion[c, i]
            if abs(shift) > limit * work.reaches[c]:
                return True
    return False


@compiled
def settle(cameras, table, prior, box, radius, schedule, tuning, step, unknowns, work, covariance, seen):  # type: ignore[no-untyped-def]
    """Move a pose in place to where it fits the collected strips best, from a step of the schedule on.

    Ends early where strips have to be collected anew. table: on which the object may stand; prior (6,):
    information on the pose given; box: the object, and its radius [m].
    Filled: covariance (6, 6) of the pose; seen (C,) of SEEN.

    Returns whether the last step was negligible, the next step, and how well the pose stands on the table,
    see `lean`.
    """
    n = len(unknowns.shared)
    rim, stands = box.rim, 0.0
    columns, less = np.empty((n, ROWS)), np.zeros((ROWS, ROWS))
    priors, pull, found = np.zeros((n, n)), np.zeros(n), blank_step(len(cameras.used), n)
    for i in range(6):
        priors[i, i] = prior[i]
    priors[EXPONENT, EXPONENT], priors[RIM, RIM] = 1.0 / EXPONENT_STD**2, 1.0 / rim[1] ** 2
    for i in range(n - UNKNOWNS):
        for k in range(n - UNKNOWNS):
            priors[UNKNOWNS + i, UNKNOWNS + k] = cameras.calm[i, k]
    doubtful = False
    for c in range(len(cameras.used)):
        doubtful |= cameras.weights[c, 0, 0] < STATED
    share, stated, converged = 1.0, 1.0, False
    while step < len(schedule.blur) and not converged:
        before = unknowns.rotation.copy(), unknowns.position.copy()
        measure_all(cameras, unknowns, schedule, step, work)
        scatter = take_stock(cameras, unknowns, tuning, work, seen)
        rough = schedule.blur[step] > 0.0
        # Only once the cameras have come to terms does a table not keep the pose from where they see it.
        late = step > 0 and schedule.blur[step - 1] == 0.0
        for turn in range(tuning.rounds):
            pull[EXPONENT] = (LIKELY.exponent - unknowns.shared[EXPONENT]) / EXPONENT_STD**2
            pull[RIM] = (rim[0] - unknowns.shared[RIM]) / rim[1] ** 2
            for i in range(UNKNOWNS, n):
                pull[i] = 0.0
                for k in range(UNKNOWNS, n):
                    pull[i] -= priors[i, k] * unknowns.shared[k]
            equations = (work.information, work.gradient, unknowns.offsets, cameras.weights, cameras.delays)
            _add_up(cameras, unknowns, tuning, schedule.tukey[step], scatter, work, seen)
            if turn == 0 and not rough:
                # Only once the cameras have come to terms is what is left the edges' own.
                own = 0.0 if late else unknowns.own[0]
                share, stated, unknowns.own[0] = sizes(
                    cameras, equations, doubtful, own, priors, pull, work, found
                )
            with_edges(cameras, work, unknowns.own[0])
            if not np.isfinite(solve_step(equations, share, priors, pull, found)):
                return False, len(schedule.blur), 0.0
            if table.known and late:
                stands = lean(table, box.half, unknowns.rotation, unknowns.position, found, columns, less)
            own_changes(found, cameras.delays)
            _move(cameras, unknowns, found.shared, found.changes, tuning, radius, work)
        whole = late and schedule.every[step] == 1
        converged = whole and _length(before, unknowns, found.known) < schedule.negligible[step]
        step += 1
        if converged:
            _add_up(cameras, unknowns, tuning, schedule.tukey[step - 1], scatter, work, seen)
            with_edges(cameras, work, unknowns.own[0])
            solve_step(equations, stated, priors, pull, found)
            if table.known:
                stands = lean(table, box.half, unknowns.rotation, unknowns.position, found, columns, less)
        if not marginal(found.known, covariance):
            return False, len(schedule.blur), 0.0
        if table.known and late:
            leaner(columns, less, covariance)
        if rough or (not converged and _astray(work, tuning.stray)):
            break
    return converged, step, stands
