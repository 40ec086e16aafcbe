"""How far off the calibration is, judged by comparing each camera's own view of the object.

A single camera locates the object well across its line of sight, poorly along it, and poorly in every
direction where fingers hide it. Poses are therefore compared by their information matrices: an uncertain
camera never counts against the others. This is a random-effects model, as in a meta-analysis of studies: R.
DerSimonian and N. Laird, "Meta-analysis in clinical trials", Controlled Clinical Trials 7, 1986.
"""

import functools
import math

import numpy as np

from tracker.compiled import compiled
from tracker.conventions import FloatArray
from tracker.geometry.linear import factorise, substitute
from tracker.pose.evidence import FULL_WEIGHT
from tracker.pose.refine import PRIOR

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
"""Error of the pose relative to the standard deviation of the cameras' errors, if these are independent, for
up to FULL_WEIGHT cameras; with more, it falls as the square root of their number."""

CONTRADICTION = 2e-3
"""Size of the cameras' errors [m] above which they contradict each other: each sees the object 3 mm or more
from where the others do. The recorded platforms' own calibrations stay below 1 mm. Larger errors come from
another platform's calibration, whose world frame is displaced, too, rather than from a camera that moved."""

NEAR_DISTANCE = 5e-3
"""Distance from the truth that the confidence promises [m]."""


@compiled
def disagreement(views, lenses, position, radius):  # type: ignore[no-untyped-def]
    """Return the log likelihood (S,) of each of SCALES, up to a constant, given what each camera sees alone.

    This is equation (27) of docs/how-it-works.md.

    Args:
        views: OwnViews of all cameras.
        lenses: (C,) of LENS.
        position: (3,) of the object [m].
        radius: of the object [m].
    """
    information, moved, _ = views
    lower, full, solved = np.empty((6, 6)), np.empty((6, 6)), np.empty((6, 6))
    joint, pull, update = np.empty((6, 6)), np.empty(6), np.empty(6)
    sight, out = np.empty(3), np.empty(len(SCALES))
    for s in range(len(SCALES)):
        joint[:, :], pull[:], total = 0.0, 0.0, 0.0
        for i in range(6):
            # Constrains directions that no camera sees.
            joint[i, i] = PRIOR[0] / radius**2 if i < 3 else PRIOR[1]
        for c in range(len(information)):
            known = information[c]
            if known[0, 0] <= 0.0:
                continue
            for i in range(3):
                sight[i] = lenses[c].position[i] - position[i]
            distance = math.sqrt(sight[0] ** 2 + sight[1] ** 2 + sight[2] ** 2)
            for i in range(6):
                for j in range(6):
                    full[i, j] = known[i, j]
            for first, scale, errors in (
                (0, SCALES[s], (ACROSS * distance, ALONG * distance)),
                (3, SCALES[s] / distance, (TILT, ROLL)),
            ):
                across, along = 1.0 / (scale**2 + errors[0] ** 2), 1.0 / (scale**2 + errors[1] ** 2)
                total -= 2.0 * math.log(across) + math.log(along)
                for i in range(3):
                    full[first + i, first + i] += across
                    for j in range(3):
                        full[first + i, first + j] += (along - across) * sight[i] * sight[j] / distance**2
            if not factorise(full, lower):
                continue
            # N - N (N + W)⁻¹ N: the camera's information with its own error marginalised.
            for i in range(6):
                total += 2.0 * math.log(lower[i, i])
                substitute(lower, known[:, i], solved[:, i])
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
    return out


_PRIOR, _LOGS = SCALES_PRIOR.tolist(), np.log(SCALES).tolist()


def probabilities(likelihoods: FloatArray) -> list[float]:
    """Probability of each of SCALES, from their log likelihoods (S,)."""
    values = likelihoods.tolist()  # for so few, NumPy is several times slower
    most = max(values)
    weights = [prior * math.exp(value - most) for prior, value in zip(_PRIOR, values, strict=True)]
    total = sum(weights)
    return [weight / total for weight in weights]


def _mean(likelihoods: FloatArray, values: list[float]) -> float:
    """Mean of one value per entry of SCALES, weighted by their probabilities."""
    return sum(share * value for share, value in zip(probabilities(likelihoods), values, strict=True))


def size(likelihoods: FloatArray | None) -> float:
    """How far the cameras disagree [m]: the geometric mean of SCALES, weighted by their probabilities.

    It is 0 if `likelihoods` is None: not judged.
    """
    return 0.0 if likelihoods is None else math.exp(_mean(likelihoods, _LOGS))


def _averaging(cameras: int) -> float:
    """Factor on the errors of the pose if more than FULL_WEIGHT cameras see the object."""
    return math.sqrt(FULL_WEIGHT / max(cameras, FULL_WEIGHT))


def spread(size: float, cameras: int) -> float:
    """Variance along each axis [m²] of the errors that a disagreement of this size [m] reveals.

    Like the between-study variance in a meta-analysis, it adds to the stated variance.
    cameras: number of cameras that see the object.
    """
    return (SHARED_SHARE * _averaging(cameras) * size) ** 2


@functools.lru_cache
def _fits(cameras: int) -> list[float]:
    """For each of SCALES the probability that the pose's error, normal along each axis, is small enough."""
    # Another platform's world frame is displaced for all cameras alike.
    whole = np.sqrt(_averaging(cameras) ** 2 + (SCALES / CONTRADICTION) ** 2)
    x = NEAR_DISTANCE / (SHARED_SHARE * SCALES * whole)
    erf = np.array([math.erf(v / math.sqrt(2.0)) for v in x])
    fits: list[float] = (erf - math.sqrt(2.0 / math.pi) * x * np.exp(-0.5 * x**2)).tolist()
    return fits


def probably_fits(likelihoods: FloatArray, cameras: int) -> float:
    """Probability that calibration errors leave the pose within NEAR_DISTANCE of the truth.

    cameras: number of cameras that see the object.
    """
    return _mean(likelihoods, _fits(cameras))
