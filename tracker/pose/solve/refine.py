"""Refinement on the edges' offsets in the full images: a pose, and all that is unknown with it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tracker.compiled import compiled
from tracker.conventions import Array, FloatArray
from tracker.geometry.lens import apply_update
from tracker.pose.edges.offset import OFFSET, measure
from tracker.pose.edges.strips import MAX_STRIPS, STRIP, edge_strips
from tracker.pose.solve.normal import accumulate, residual
from tracker.pose.solve.robust import spread
from tracker.pose.solve.step import EXPONENT, GROWTH, UNKNOWNS, calibration_share, marginal, solve_step

NOISE = 1.5
"""Least standard deviation of a pixel's channel [levels]; what does not fit the model raises it."""

MIN_WIDTHS = 4
"""Pieces that must show the blur before it is believed."""

LIKELY_EXPONENT, EXPONENT_STD = 0.3, 0.5
"""Prior of the response's exponent, less 1: between that of simulations and of cameras."""

GROWTH_STD = 0.003
"""Relative standard deviation of the object's size: makers and rulers err by 0.2 mm in 65."""

STATED = 1e11
"""Inverse variance of a position from which on a calibration states no errors that it could have a share of
(see covariance.LEAST_VARIANCE)."""


class Pictures(NamedTuple):
    """What the refinement looks at."""

    images: Array
    """(C, H, W, 3) uint8."""
    mosaics: Array
    """(C,) which pixels measured red, or -1."""
    channels: Array
    """(C, 3, 256) offsets into the label table of each level."""
    table: Array
    """The label table."""
    lenses: Array
    """(C,) of LENS."""
    scales: FloatArray
    """(C,) focal lengths over the reference."""
    used: Array
    """(C,) bool: whether there is an image."""


class Unknowns(NamedTuple):
    """What is solved for; changed in place."""

    rotation: FloatArray
    """(3, 3) world_from_object."""
    position: FloatArray
    """(3,) [m]."""
    shared: FloatArray
    """(UNKNOWNS,) of which EXPONENT and GROWTH count."""
    offsets: FloatArray
    """(C, 6) by which the cameras see the object moved [m, rad]."""
    blurs: FloatArray
    """(C,) [px]"""


class Workspace(NamedTuple):
    """Arrays that the refinement works in."""

    strips: Array
    """(C, MAX_STRIPS) of STRIP."""
    found: Array
    """(C, MAX_STRIPS) of OFFSET."""
    counts: Array
    """(C,) strips of each camera."""
    reaches: FloatArray
    """(C,) half widths of the strips [px]."""
    residuals: FloatArray
    widths: FloatArray
    information: FloatArray
    """(C, UNKNOWNS, UNKNOWNS) normal equations of each camera, and …"""
    gradient: FloatArray
    """(C, UNKNOWNS) … their right side."""


def workspace(cameras: int) -> Workspace:
    """A new work space."""
    return Workspace(
        np.empty((cameras, MAX_STRIPS), STRIP),
        np.empty((cameras, MAX_STRIPS), OFFSET),
        np.zeros(cameras, np.int64),
        np.zeros(cameras),
        np.empty(cameras * MAX_STRIPS),
        np.empty(MAX_STRIPS),
        np.zeros((cameras, UNKNOWNS, UNKNOWNS)),
        np.zeros((cameras, UNKNOWNS)),
    )


@compiled
def _look(pictures, box, unknowns, schedule, tuning, step, work):  # type: ignore[no-untyped-def]
    """Measure the offsets of all strips at the present pose."""
    for c in range(len(pictures.used)):
        if not pictures.used[c]:
            continue
        scale = pictures.scales[c]
        rotation, position = unknowns.rotation.copy(), unknowns.position.copy()
        apply_update(rotation, position, unknowns.offsets[c])
        blur = schedule.blur[step] * scale if schedule.blur[step] > 0.0 else unknowns.blurs[c]
        work.reaches[c] = max(2.5, tuning.reach[0] * scale + tuning.reach[1] * blur)
        work.counts[c] = edge_strips(
            pictures.lenses, c, box.half, box.face_labels, rotation, position,
            schedule.piece[step] * scale, tuning.margin[0] * scale + tuning.margin[1] * blur, work.strips[c],
        )  # fmt: skip
        lens = pictures.lenses[c]
        measure(
            pictures.images[c], lens.width, lens.height, pictures.mosaics[c], pictures.channels[c],
            pictures.table, work.strips[c], work.counts[c], work.reaches[c], blur, NOISE,
            schedule.every[step], work.found[c],
        )  # fmt: skip


@compiled
def _take_stock(pictures, unknowns, schedule, tuning, step, work, seen):  # type: ignore[no-untyped-def]
    """Count the strips, judge the blurs anew; returns how far the residuals scatter [px]."""
    total, knowing, known_blur = 0, 0, 0.0
    for c in range(len(pictures.used)):
        clear(seen[c])
        if not pictures.used[c]:
            continue
        scale = pictures.scales[c]
        blur = schedule.blur[step] * scale if schedule.blur[step] > 0.0 else unknowns.blurs[c]
        widths = 0
        for s in range(work.counts[c]):
            seen[c].expected += 1.0
            found = work.found[c, s]
            if not found.usable:
                continue
            seen[c].usable += 1.0
            off = residual(work.strips[c, s], found, unknowns.shared[EXPONENT], unknowns.shared[GROWTH])
            work.residuals[total] = abs(off / scale)
            total += 1
            if abs(off / scale) < 1.0 and found.sharpness > 0.0:
                work.widths[widths] = found.wider
                widths += 1
        if widths >= MIN_WIDTHS:
            wider = min(1.0, max(-0.6 * blur, np.median(work.widths[:widths])))
            unknowns.blurs[c] = min(max(blur + wider, tuning.least_blur), tuning.largest_blur * scale)
            known_blur += unknowns.blurs[c] / scale
            knowing += 1
        else:
            unknowns.blurs[c] = 0.0
    for c in range(len(pictures.used)):
        # A camera that shows narrow faces only takes its blur from the others.
        if unknowns.blurs[c] == 0.0:
            likely = known_blur / knowing if knowing > 0 else tuning.start_blur
            unknowns.blurs[c] = pictures.scales[c] * likely
        seen[c].blur = unknowns.blurs[c]
    return spread(work.residuals[:total])


@compiled
def clear(seen):  # type: ignore[no-untyped-def]
    """Set what the refinement says of a camera to nothing."""
    seen.expected, seen.usable, seen.inliers, seen.squares = 0.0, 0.0, 0.0, 0.0


@compiled
def _add_up(pictures, unknowns, tuning, least, scatter, work, seen):  # type: ignore[no-untyped-def]
    """The normal equations of every camera."""
    limit = max(least, tuning.tukey * scatter)
    for c in range(len(pictures.used)):
        work.information[c, :, :], work.gradient[c, :] = 0.0, 0.0
        if not pictures.used[c]:
            continue
        scale = pictures.scales[c]
        accumulate(
            work.strips[c], work.found[c], work.counts[c], unknowns.shared[EXPONENT], unknowns.shared[GROWTH],
            min(limit * scale, work.reaches[c]), (max(tuning.floor, 0.7 * scatter) * scale) ** 2,
            work.information[c], work.gradient[c], seen[c],
        )  # fmt: skip
        trust = 1.0 if pictures.mosaics[c] >= 0 else 1.0 / tuning.correlation**2
        work.information[c] *= trust
        work.gradient[c] *= trust


@compiled
def _move(unknowns, update, changes, tuning):  # type: ignore[no-untyped-def]
    """Change the unknowns by a step, or by as much of it as is not too long."""
    shift = np.sqrt(np.sum(update[:3] ** 2))
    turn = np.sqrt(np.sum(update[3:6] ** 2))
    limit = max(shift / tuning.longest, turn / tuning.largest, 1.0)
    apply_update(unknowns.rotation, unknowns.position, update / limit)
    for i in range(6, UNKNOWNS):
        unknowns.shared[i] += update[i] / limit
    unknowns.offsets[:] += changes / limit


@compiled
def _length(update, known):  # type: ignore[no-untyped-def]
    """Squared length of the pose's part of a step, in standard deviations."""
    size = 0.0
    for i in range(6):
        for k in range(6):
            size += update[i] * known[i, k] * update[k]
    return size


@compiled
def refine(pictures, box, weights, prior, schedule, tuning, unknowns, work, information, seen):  # type: ignore[no-untyped-def]
    """Move a pose in place to where it fits the contours best; returns whether that converged, and steps.

    weights (C, 6, 6): inverse covariance of the cameras' offsets; prior (6,): information on the pose given.
    Filled: information (6, 6) on the pose; seen (C,) of SEEN.
    """
    joint, update, pull = np.zeros((UNKNOWNS, UNKNOWNS)), np.zeros(UNKNOWNS), np.zeros(UNKNOWNS)
    changes, priors = np.zeros((len(pictures.used), 6)), np.zeros((UNKNOWNS, UNKNOWNS))
    for i in range(6):
        priors[i, i] = prior[i]
    priors[EXPONENT, EXPONENT], priors[GROWTH, GROWTH] = 1.0 / EXPONENT_STD**2, 1.0 / GROWTH_STD**2
    doubtful = weights[:, 0, 0].min() < STATED
    converged, share, steps = False, 1.0, len(schedule.blur)
    for step in range(steps):
        _look(pictures, box, unknowns, schedule, tuning, step, work)
        scatter = _take_stock(pictures, unknowns, schedule, tuning, step, work, seen)
        _add_up(pictures, unknowns, tuning, schedule.tukey[step], scatter, work, seen)
        pull[EXPONENT] = (LIKELY_EXPONENT - unknowns.shared[EXPONENT]) / EXPONENT_STD**2
        pull[GROWTH] = -unknowns.shared[GROWTH] / GROWTH_STD**2
        equations = (work.information, work.gradient, unknowns.offsets, weights)
        if schedule.blur[step] == 0.0 and doubtful:
            share = calibration_share(equations, priors, pull, joint, update, changes)
        if not np.isfinite(solve_step(equations, share, priors, pull, joint, update, changes)):
            break
        size = _length(update, joint)
        _move(unknowns, update, changes, tuning)
        whole = schedule.blur[step] == 0.0 and schedule.every[step] == 1 and step >= schedule.least
        if whole and size < schedule.negligible[step]:
            converged, steps = True, step + 1
            break
    marginal(joint, information)
    return converged, steps
