"""Whether a fit is the object, and how probably it is right: all from the evidence for it and against it."""

from __future__ import annotations

import functools
import math

import numpy as np

from tracker.conventions import FloatArray
from tracker.geometry.probability import probability_within
from tracker.pose.agreement import probably_fits
from tracker.pose.fit import Fit
from tracker.pose.result import Status

EXPECTED = 20
"""Pixels of its label map that the object must fill for a camera to have a say."""

ASTRAY = 30, 0.15
"""Least number, as a share of the pixels expected, too, of pixels in the object's colours where it is not, by
which a camera that does not see the object there counts as seeing it elsewhere."""

MIN_VIEW = 4.0
"""Weight of the pieces of edges on which a camera must agree to count as seeing the object."""

MIN_TRUST = 0.2
"""Probability that the fit sits on the object below which there had better be no pose."""

SURE = 0.95
"""Probability of it at which no other hypothesis is tried."""

CERTAIN = 500.0
"""Log odds beyond which nothing differs: many cameras may say more than a number can hold."""

VAGUE, MIN_DEFINITE = (0.02, math.radians(5)), 0.5
"""The pose must be this close to the truth [m, rad] with this probability, or many poses would do."""

NEAR = 5e-3, math.radians(5)
"""What the confidence promises: the pose is this close to the truth [m, rad]."""

NEARNESS = 1.06, 0.93
"""Log odds that a pose is as near as that, and their growth with those which its covariance states: a
covariance may be too small or too large. Fitted by scripts/fit_confidence.py."""


_once = functools.lru_cache(maxsize=32)
"""A judgement of a fit is asked for several times: what was found is kept for the latest fits."""


@_once
def alone(fit: Fit) -> bool:
    """Whether the pose rests on what one camera sees."""
    return sum(one["inliers"] >= MIN_VIEW for one in fit.counts) < 2


@_once
def supporters(fit: Fit) -> int:
    """How many cameras probably see the object where the fit has it."""
    return sum(one["shows"] > 0.5 for one in fit.counts)


def unanimous(fit: Fit) -> bool:
    """Whether all cameras in whose pictures the object should be see it where the fit has it."""
    return supporters(fit) == sum(one["predicted"] > 0 for one in fit.counts)


@_once
def contradicting(fit: Fit) -> tuple[bool, ...]:
    """Whether each camera sees the object elsewhere, or something else where the fit has it."""
    result = []
    for one in fit.counts:
        predicted, outside = one["predicted"], one["extra"] + one["elsewhere"] + one["wrong"]
        astray = outside >= max(ASTRAY[0], ASTRAY[1] * predicted) or one["broken"] > 0.5
        result.append(predicted >= EXPECTED and one["shows"] <= 0.5 and astray)
    return tuple(result)


def rank(fit: Fit) -> float:
    """Log odds of a fit over nothing there, by which it is compared with fits to the same pictures."""
    return fit.evidence.ahead


@_once
def log_odds(fit: Fit) -> float:
    """Log odds that the object is here, over another body or nothing, if no other pose explains as much."""
    less, more = sorted((fit.evidence.body, fit.evidence.nothing))
    return -more - math.log1p(math.exp(less - more))


def disputed(fit: Fit) -> int:
    """How many cameras outvote a single one that shows the object: each of them may be right instead."""
    against = sum(contradicting(fit)) if supporters(fit) < 2 else 0
    return against if against > 1 else 0


@_once
def trust(fit: Fit) -> float:
    """Probability that the fit sits on the object, at whatever accuracy."""
    others = -log_odds(fit), -fit.lead, fit.evidence.resized
    return 1.0 / (1.0 + sum(math.exp(min(one, CERTAIN)) for one in others) + disputed(fit))


def settled(fit: Fit) -> bool:
    """Whether no other hypothesis needs to be tried: one camera alone never settles the matter."""
    return trust(fit) > SURE and fit.converged and fit.inside and not alone(fit)


@_once
def refusal(fit: Fit) -> Status | None:
    """Why the fit is not accepted; None where it is."""
    if not np.isfinite(fit.covariance).all():
        return Status.POOR_FIT
    if not fit.inside:
        # One camera alone takes what hides the object's edges for them, and puts it too far away.
        return Status.AMBIGUOUS if alone(fit) else Status.INCONSISTENT_VIEWS
    if trust(fit) < MIN_TRUST:
        return _against(fit)
    return Status.AMBIGUOUS if probably_near(fit.covariance, VAGUE) < MIN_DEFINITE else None


def _against(fit: Fit) -> Status:
    """What speaks most against a fit."""
    nothing, body = fit.evidence.nothing, max(fit.evidence.body, fit.evidence.resized)
    if -fit.lead > max(body, nothing):
        return Status.AMBIGUOUS
    if body > nothing:
        return Status.OTHER_OBJECT
    if any(contradicting(fit)):
        return Status.INCONSISTENT_VIEWS
    return Status.POOR_FIT if supporters(fit) else Status.TOO_FEW_PIXELS


def probably_near(covariance: FloatArray, limits: tuple[float, float] = NEAR) -> float:
    """Probability that a pose with this covariance (6, 6) is within limits [m, rad] of the truth."""
    return probability_within(covariance, *limits)


def nearness(covariance: FloatArray) -> float:
    """Probability that a pose is within 5 mm and 5° of the truth, given how often stated ones were."""
    stated = probably_near(covariance)
    odds = min(max(stated, 1e-6), 1.0 - 1e-6)
    shift, growth = NEARNESS
    return 1.0 / (1.0 + math.exp(-shift) * (odds / (1.0 - odds)) ** -growth) if stated > 0.0 else 0.0


def fits(fit: Fit) -> float:
    """Probability that the calibration, as far as it was judged, leaves the pose within 5 mm."""
    return 1.0 if fit.disagreement is None else probably_fits(fit.disagreement)


@_once
def apparent(fit: Fit) -> float:
    """The confidence of a fit if the calibration is right as far as its files state."""
    return trust(fit) * nearness(fit.covariance)


def confidence(fit: Fit) -> float:
    """Probability that the pose is within 5 mm and 5° of the truth: equation (21) of docs/how-it-works.md."""
    return fits(fit) * apparent(fit)
