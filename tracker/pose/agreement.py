"""How far off the calibration is, judged by comparing each camera's own view of the object.

A single camera locates the object well across its line of sight, poorly along it, and poorly in every
direction where fingers hide it. Poses are therefore compared by their information matrices: an uncertain
camera never counts against the others. This is a random-effects model, as in a meta-analysis of studies: R.
DerSimonian and N. Laird, "Meta-analysis in clinical trials", Controlled Clinical Trials 7, 1986.
"""

from __future__ import annotations

import math

import numpy as np

from tracker.compiled import compiled
from tracker.conventions import FloatArray
from tracker.geometry.linear import factorise, substitute
from tracker.pose.fit import OwnViews

SCALES = np.array([1e-4, 2e-4, 4e-4, 7e-4, 1.2e-3, 2e-3, 3.5e-3, 6e-3, 1e-2, 1.7e-2, 3e-2])
"""Candidate standard deviations, along each axis, of the object's displacement in the cameras' views [m]."""

SCALES_PRIOR = np.array([0.06, 0.12, 0.2, 0.22, 0.2, 0.1, 0.04, 0.025, 0.02, 0.01, 0.005])
"""Prior probability of each."""

ACROSS, ALONG = 2e-4, 4e-3
"""Errors of a single view that calibration does not cause, relative to the object's distance: across the line
of sight, and along it, where edges that look wider make the object seem nearer."""

TILT, ROLL = 8e-3, 3e-3
"""The same for rotation: about axes across the line of sight, and about the line of sight [rad]."""

SHARED_SHARE = 0.8
"""Error of the pose relative to the standard deviation of the cameras' errors, if these are independent."""

OTHERS = 2e-3
"""Standard deviation [m] above which the errors come not from a camera that moved but from another platform's
calibration, whose world frame is displaced, too."""

CONTRADICTION = 2e-3
"""Size of the cameras' errors [m] above which they contradict each other: each sees the object 3 mm or more
from where the others do. The recorded platforms' own calibrations stay below 1 mm."""

NEAR_DISTANCE = 5e-3
"""Distance from the truth that the confidence promises [m]."""


@compiled
def log_likelihoods(information, moved, rotations, distances, prior, out):  # type: ignore[no-untyped-def]
    """Log likelihood of each of SCALES, up to a constant: equation (27) of docs/how-it-works.md.

    Args:
        information: (C, 6, 6) of the pose that each camera sees by itself [1/m², 1/rad²].
        moved: (C, 6) that pose minus the joint pose [m, rad].
        rotations: (C, 3, 3) camera from world.
        distances: (C,) from each camera to the object [m].
        prior: (6,) information that constrains directions no camera sees [1/m², 1/rad²].
        out: (S,), filled.
    """
    lower, full = np.empty((6, 6)), np.empty((6, 6))
    column, solved = np.empty(6), np.empty((6, 6))
    joint, pull, update = np.empty((6, 6)), np.empty(6), np.empty(6)
    weights = np.empty((2, 3))
    for s in range(len(SCALES)):
        joint[:, :], pull[:], total = 0.0, 0.0, 0.0
        for i in range(6):
            joint[i, i] = prior[i]
        for c in range(len(information)):
            known, distance = information[c], distances[c]
            if known[0, 0] <= 0.0:
                continue
            for k in range(3):
                error, turn = (ACROSS, TILT) if k < 2 else (ALONG, ROLL)
                weights[0, k] = 1.0 / (SCALES[s] ** 2 + (error * distance) ** 2)
                weights[1, k] = 1.0 / ((SCALES[s] / distance) ** 2 + turn**2)
                total -= math.log(weights[0, k]) + math.log(weights[1, k])
            for i in range(6):
                for j in range(6):
                    full[i, j] = known[i, j]
                    if i // 3 == j // 3:
                        for k in range(3):
                            axes = rotations[c, k, i % 3] * rotations[c, k, j % 3]
                            full[i, j] += weights[i // 3, k] * axes
            if not factorise(full, lower):
                continue
            # N - N (N + W)⁻¹ N: the camera's information with its own error marginalised.
            for i in range(6):
                total += 2.0 * math.log(lower[i, i])
                for j in range(6):
                    column[j] = known[j, i]
                substitute(lower, column, column)
                for j in range(6):
                    solved[j, i] = column[j]
            for i in range(6):
                for j in range(6):
                    value = known[i, j]
                    for k in range(6):
                        value -= known[i, k] * solved[k, j]
                    joint[i, j] += value
                    pull[i] += value * moved[c, j]
                    total += moved[c, i] * value * moved[c, j]
        if factorise(joint, lower):
            substitute(lower, pull, update)
            for i in range(6):
                total += 2.0 * math.log(lower[i, i]) - pull[i] * update[i]
        out[s] = -0.5 * total


def disagreement(
    views: OwnViews, rotations: FloatArray, positions: FloatArray, position: FloatArray, radius: float
) -> FloatArray:
    """Log likelihoods (S,) of SCALES, given what each camera sees by itself.

    Args:
        views: the pose that each camera sees by itself.
        rotations: (C, 3, 3) camera from world.
        positions: (C, 3) of the cameras [m].
        position: (3,) of the object [m].
        radius: of the object [m].
    """
    distances = np.sqrt(((positions - position) ** 2).sum(axis=1))
    prior = np.array([3.0 / radius**2] * 3 + [10.0] * 3)
    out = np.empty(len(SCALES))
    # As a field of an array of records they are not contiguous.
    rotations = np.ascontiguousarray(rotations)
    log_likelihoods(views.information, views.moved, rotations, distances, prior, out)
    return out


def probabilities(likelihoods: FloatArray) -> FloatArray:
    """Probability (S,) of each of SCALES, from their log likelihoods (S,)."""
    weights: FloatArray = SCALES_PRIOR * np.exp(likelihoods - likelihoods.max())
    return np.asarray(weights / weights.sum())


def size(likelihoods: FloatArray) -> float:
    """How far the cameras disagree [m]: the geometric mean of SCALES by their probabilities."""
    return float(np.exp(probabilities(likelihoods) @ np.log(SCALES)))


def spread(likelihoods: FloatArray | None) -> float:
    """Variance along each axis [m²] of the errors that disagreement reveals; 0 for None: not judged.

    Like the between-study variance in a meta-analysis, it adds to the stated variance.
    """
    return 0.0 if likelihoods is None else (SHARED_SHARE * size(likelihoods)) ** 2


def contradict(likelihoods: FloatArray | None) -> bool:
    """Whether the cameras disagree so much that their calibration is doubtful; False for None: not judged."""
    return likelihoods is not None and size(likelihoods) > CONTRADICTION


def _within(std: FloatArray) -> FloatArray:
    """Probability that a vector, normal with deviations (S,) [m] per axis, is shorter than NEAR_DISTANCE."""
    x = NEAR_DISTANCE / std
    erf = np.array([math.erf(v / math.sqrt(2.0)) for v in x])
    return np.asarray(erf - math.sqrt(2.0 / math.pi) * x * np.exp(-0.5 * x**2))


_FITS = _within(SHARED_SHARE * SCALES * np.sqrt(1.0 + (SCALES / OTHERS) ** 2))


def probably_fits(likelihoods: FloatArray) -> float:
    """Probability that calibration errors leave the pose within NEAR_DISTANCE of the truth."""
    return float(probabilities(likelihoods) @ _FITS)
