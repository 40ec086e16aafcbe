"""Refinement on the edges' offsets in the full images: a pose, and all that is unknown with it."""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np

from tracker.conventions import Array, FloatArray
from tracker.pose import edges
from tracker.pose.edges import COLUMNS, MAX_SAMPLES, J, edge_samples
from tracker.pose.lens import apply_update
from tracker.pose.profile import BLOOM, MEASURED, OFFSET, SHARPNESS, VALID, VARIANCE, WIDER, measure
from tracker.pose.step import EXPONENT, GROWTH, UNKNOWNS, calibration_share, solve_step

NOISE = 1.5
"""Least standard deviation of a pixel's channel [levels]; what does not fit the model raises it."""

EXPECTED, USABLE, INLIERS, SQUARES, BLUR = range(5)
SUMMARY = 5
"""Columns of a camera's summary: pieces of edges, usable ones, inlier weight, inliers' weighted squared
residuals [px²], blur [px]."""

MIN_WIDTHS = 4
"""Pieces that must show the blur before it is believed."""

LIKELY_EXPONENT, EXPONENT_STD = 0.3, 0.5
"""Prior of the response's exponent, less 1: between that of simulations and of cameras."""

GROWTH_STD = 0.003
"""Relative standard deviation of the object's size: makers and rulers err by 0.2 mm in 65."""


class Schedule(NamedTuple):
    """How the refinement goes on, lengths at a focal length of REFERENCE_FOCAL."""

    blur: FloatArray
    """(steps,) standard deviation of the model's steps [px]; 0: as measured."""
    piece: FloatArray
    """(steps,) length of the pieces of edges [px]."""
    tukey: FloatArray
    """(steps,) residual at which a piece's weight reaches zero: at least so much [px]."""
    every: Array
    """(steps,) one in so many pieces is looked at; the refinement ends after a step with all of them."""
    least: int
    """Steps before which the refinement does not end."""
    negligible: FloatArray
    """(steps,) squared length of a step, in standard deviations of the pose, below which the refinement
    ends."""


class Tuning(NamedTuple):
    """Figures of the refinement, lengths at the reference focal length."""

    reach: tuple[float, float]
    """Half width of the strips along the edges: [px], and for each px of blur."""
    margin: tuple[float, float]
    """Distance that pieces keep from corners, where three surfaces mix: [px], and for each px of blur."""
    floor: float
    """Standard deviation of an edge's place that noise does not explain [px]."""
    tukey: float
    """Residual at which a piece's weight reaches zero [robust standard deviations]."""
    correlation: float
    """Factor on the standard deviation of pieces where neighbouring pixels share errors: unless each of a
    mosaic's counts only for what it measured."""
    start_blur: float
    least_blur: float
    largest_blur: float
    """Standard deviation of the image's steps before it is measured, and its bounds [px]."""
    longest: float
    """Longest step [m]; the strips say nothing on what lies farther away."""
    largest: float
    """Largest turn of a step [rad]."""


class Workspace(NamedTuple):
    """Arrays that the refinement works in, made once."""

    samples: FloatArray
    measured: FloatArray
    residuals: FloatArray
    widths: FloatArray


def workspace(cameras: int) -> Workspace:
    """A new work space."""
    return Workspace(
        np.empty((cameras, MAX_SAMPLES, COLUMNS)),
        np.empty((cameras, MAX_SAMPLES, MEASURED)),
        np.empty(cameras * MAX_SAMPLES),
        np.empty(MAX_SAMPLES),
    )


@numba.njit(cache=True, nogil=True)
def accumulate(samples, measured, n, exponent, growth, tukey, floor, matrix, vector, summary):  # type: ignore[no-untyped-def]
    """Add n weighted measurements to the normal equations (8, 8), (8,) and the summary."""
    row = np.empty(UNKNOWNS)
    for s in range(n):
        if measured[s, VALID] == 0.0:
            continue
        r = measured[s, OFFSET] - exponent * measured[s, BLOOM] - growth * samples[s, edges.GROWTH]
        if abs(r) >= tukey:
            continue
        robust = (1.0 - (r / tukey) ** 2) ** 2
        summary[INLIERS] += robust
        summary[SQUARES] += robust * r * r
        weight = robust / (floor + measured[s, VARIANCE])
        for i in range(6):
            row[i] = samples[s, J + i]
        row[EXPONENT], row[GROWTH] = measured[s, BLOOM], samples[s, edges.GROWTH]
        for i in range(UNKNOWNS):
            vector[i] += weight * row[i] * r
            for k in range(UNKNOWNS):
                matrix[i, k] += weight * row[i] * row[k]


@numba.njit(cache=True, nogil=True)
def refine(  # type: ignore[no-untyped-def]
    images, mosaics, lenses, scales, used, channels, table, box, weights, prior, schedule, tuning,
    rotation, position, work, known, summary,
):  # fmt: skip
    """Move a pose in place to where it fits the contours best; returns whether that converged.

    images (C, H, W, 3); scales (C,): focal lengths over the reference; channels (C, 3, 256); weights
    (C, 6, 6): inverse covariance of the cameras' offsets; prior (6,): information on the pose given.
    Filled: known (6, 6), the information on the pose; summary (C, SUMMARY).
    """
    cameras, steps = len(used), len(schedule.blur)
    counts = np.zeros(cameras, np.int64)
    offsets, changes = np.zeros((cameras, 6)), np.zeros((cameras, 6))
    information, gradient = np.zeros((cameras, UNKNOWNS, UNKNOWNS)), np.zeros((cameras, UNKNOWNS))
    joint, shared, pull = np.zeros((UNKNOWNS, UNKNOWNS)), np.zeros(UNKNOWNS), np.zeros(UNKNOWNS)
    priors = np.zeros((UNKNOWNS, UNKNOWNS))
    blurs = tuning.start_blur * scales
    exponent, growth = LIKELY_EXPONENT, 0.0
    for i in range(6):
        priors[i, i] = prior[i]
    priors[EXPONENT, EXPONENT], priors[GROWTH, GROWTH] = 1.0 / EXPONENT_STD**2, 1.0 / GROWTH_STD**2
    reaches = np.zeros(cameras)
    converged, share = False, 1.0
    # A calibration that states no errors (see covariance.LEAST_VARIANCE) has none to take a share of.
    doubtful = weights[:, 0, 0].min() < 1e11
    for step in range(steps):
        total, knowing, known_blur = 0, 0, 0.0
        for c in range(cameras):
            summary[c, :] = 0.0
            if not used[c]:
                continue
            scale = scales[c]
            seen_rotation, seen_position = rotation.copy(), position.copy()
            apply_update(seen_rotation, seen_position, offsets[c])
            blur = schedule.blur[step] * scale if schedule.blur[step] > 0.0 else blurs[c]
            reaches[c] = max(2.5, tuning.reach[0] * scale + tuning.reach[1] * blur)
            counts[c] = edge_samples(
                lenses, c, box.half, box.face_labels, seen_rotation, seen_position,
                schedule.piece[step] * scale, tuning.margin[0] * scale + tuning.margin[1] * blur,
                work.samples[c],
            )  # fmt: skip
            measure(
                images[c], lenses[c].width, lenses[c].height, mosaics[c], channels[c], table,
                work.samples[c], counts[c], reaches[c], blur, NOISE, schedule.every[step], work.measured[c],
            )  # fmt: skip
            widths = 0
            for s in range(counts[c]):
                summary[c, EXPECTED] += 1.0
                measured = work.measured[c, s]
                if measured[VALID] == 0.0:
                    continue
                summary[c, USABLE] += 1.0
                r = measured[OFFSET] - exponent * measured[BLOOM]
                r = (r - growth * work.samples[c, s, edges.GROWTH]) / scale
                work.residuals[total] = abs(r)
                total += 1
                if abs(r) < 1.0 and measured[SHARPNESS] > 0.0:
                    work.widths[widths] = measured[WIDER]
                    widths += 1
            if widths >= MIN_WIDTHS:
                wider = min(1.0, max(-0.6 * blur, np.median(work.widths[:widths])))
                blurs[c] = min(max(blur + wider, tuning.least_blur), tuning.largest_blur * scale)
                known_blur += blurs[c] / scale
                knowing += 1
            else:
                blurs[c] = 0.0
        for c in range(cameras):
            # A camera that shows narrow faces only takes its blur from the others.
            if blurs[c] == 0.0:
                blurs[c] = scales[c] * (known_blur / knowing if knowing > 0 else tuning.start_blur)
            summary[c, BLUR] = blurs[c]
        # The median of all, unlike the inliers' mean square, does not shrink by leaving out what disagrees.
        spread = 1.4826 * np.median(work.residuals[:total]) if total > 0 else 1.0
        tukey = max(schedule.tukey[step], tuning.tukey * spread)
        for c in range(cameras):
            information[c, :, :], gradient[c, :] = 0.0, 0.0
            if used[c]:
                accumulate(
                    work.samples[c], work.measured[c], counts[c], exponent, growth,
                    min(tukey * scales[c], reaches[c]),
                    (max(tuning.floor, 0.7 * spread) * scales[c]) ** 2,
                    information[c], gradient[c], summary[c],
                )  # fmt: skip
                trust = 1.0 if mosaics[c] >= 0 else 1.0 / tuning.correlation**2
                information[c] *= trust
                gradient[c] *= trust
        pull[EXPONENT] = (LIKELY_EXPONENT - exponent) / EXPONENT_STD**2
        pull[GROWTH] = -growth / GROWTH_STD**2
        if schedule.blur[step] == 0.0 and doubtful:
            share = calibration_share(
                information, gradient, offsets, weights, priors, pull, joint, shared, changes
            )
        doubt = solve_step(
            information, gradient, offsets, weights, share, priors, pull, joint, shared, changes
        )
        if not np.isfinite(doubt):
            break
        size = 0.0
        for i in range(6):
            for k in range(6):
                size += shared[i] * joint[i, k] * shared[k]
        shift = np.sqrt(np.sum(shared[:3] ** 2))
        turn = np.sqrt(np.sum(shared[3:6] ** 2))
        limit = max(shift / tuning.longest, turn / tuning.largest, 1.0)
        apply_update(rotation, position, shared / limit)
        exponent += shared[EXPONENT] / limit
        growth += shared[GROWTH] / limit
        offsets += changes / limit
        if (
            schedule.blur[step] == 0.0
            and schedule.every[step] == 1
            and step >= schedule.least
            and size < schedule.negligible[step]
        ):
            converged = True
            break
    # What is known of the pose where exponent and growth are not.
    a, b, d = joint[EXPONENT, EXPONENT], joint[EXPONENT, GROWTH], joint[GROWTH, GROWTH]
    inverse = 1.0 / (a * d - b * b)
    for i in range(6):
        e, g = joint[i, EXPONENT], joint[i, GROWTH]
        for k in range(6):
            ek, gk = joint[EXPONENT, k], joint[GROWTH, k]
            known[i, k] = joint[i, k] - inverse * (e * (d * ek - b * gk) + g * (a * gk - b * ek))
    return converged
