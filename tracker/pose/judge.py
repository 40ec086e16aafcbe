"""Whether a fit is the object and how likely it is right, from the evidence for it and against it."""

import functools
import math

from tracker.conventions import FloatArray
from tracker.geometry.probability import probability_within
from tracker.pose.agreement import NEAR_DISTANCE, probably_fits
from tracker.pose.align import EXPECTED
from tracker.pose.fit import Fit
from tracker.pose.result import Status

ASTRAY = 0.15
"""A camera sees the object elsewhere if so many pixels in its colours, relative to those expected, and at
least EXPECTED, lie where the fit has none."""

MIN_VIEW = 8.0
"""Smallest weight of matched pieces of edge for a camera to count as seeing the object."""

MIN_TRUST = 0.2
"""Smallest probability that a fit is the object for it to be accepted."""

SETTLED = 0.95
"""Probability that a fit is the object, above which no other hypothesis is tried."""

CLEAR = 0.5
"""Probability that a fit seen by all cameras is the object, above which no other position is tried."""

MOST_ODDS = 500.0
"""Log odds are capped at this, since their exponential may overflow with many cameras."""

NEAR = NEAR_DISTANCE, math.radians(5)
"""What the confidence promises: the pose is this close to the truth [m, rad]."""

VAGUE, MIN_DEFINITE = (2.0 * NEAR_DISTANCE, NEAR[1]), 0.5
"""A pose is accepted if it is this close to the truth [m, rad] with at least this probability."""

SINGLE = 2.9
"""Factor on the odds that a single camera's pose is that close: its covariance is too large. Fitted by
scripts/fit_confidence.py."""


_once = functools.lru_cache(maxsize=32)
"""Caches the judgements of the latest fits, since each is needed several times."""


@_once
def resting_on(fit: Fit) -> tuple[int, ...]:
    """Cameras that the pose rests on."""
    return tuple(c for c, one in enumerate(fit.counts) if one.inliers >= MIN_VIEW)


def alone(fit: Fit) -> bool:
    """Whether the pose rests on a single camera."""
    return len(resting_on(fit)) < 2


@_once
def supporters(fit: Fit) -> int:
    """Number of cameras that probably see the object at the fit."""
    return sum(one.shows > 0.5 for one in fit.counts)


def unanimous(fit: Fit) -> bool:
    """Whether all cameras that should see the object see it at the fit."""
    return supporters(fit) == sum(one.predicted > 0 for one in fit.counts)


def well_placed(fit: Fit) -> bool:
    """Whether the position is certain, and at most the rotation is in doubt."""
    return unanimous(fit) and trust(fit) > CLEAR


@_once
def contradicting(fit: Fit) -> tuple[bool, ...]:
    """Whether each camera sees the object elsewhere, or something else at the fit."""
    result = []
    for one in fit.counts:
        predicted, outside = one.predicted, one.extra + one.elsewhere + one.wrong
        astray = outside >= max(EXPECTED, ASTRAY * predicted) or one.broken > 0.5
        result.append(predicted >= EXPECTED and one.shows <= 0.5 and astray)
    return tuple(result)


def rank(fit: Fit) -> float:
    """Log odds of a fit over nothing, by which fits to the same images compete."""
    return fit.evidence.ahead


@_once
def log_odds(fit: Fit) -> float:
    """Log odds of the object over another body or nothing; other poses are not considered."""
    less, more = sorted((fit.evidence.body, fit.evidence.nothing))
    return -more - math.log1p(math.exp(less - more))


def disputed(fit: Fit) -> int:
    """Number of cameras that outvote the only one that shows the object: any of them may be right."""
    against = sum(contradicting(fit)) if supporters(fit) < 2 else 0
    return against if against > 1 else 0


@_once
def trust(fit: Fit) -> float:
    """Probability that the fit is the object, however accurate the pose is."""
    others = -log_odds(fit), -fit.lead, fit.resized
    return 1.0 / (1.0 + sum(math.exp(min(one, MOST_ODDS)) for one in others) + disputed(fit))


def settled(fit: Fit) -> bool:
    """Whether no other hypothesis needs to be tried; a single camera never settles it."""
    return trust(fit) > SETTLED and fit.converged and fit.inside and not alone(fit)


@_once
def refusal(fit: Fit) -> Status | None:
    """Why the fit is refused; None: it is accepted."""
    if not math.isfinite(fit.covariance.trace()):
        return Status.POOR_FIT
    if not fit.inside:
        # A single camera may mistake an occluder's edges for the object's and put it too far away.
        return Status.AMBIGUOUS if alone(fit) else Status.INCONSISTENT_VIEWS
    if trust(fit) < MIN_TRUST:
        return against(fit)
    # The smaller limits, which the confidence needs anyway, mostly tell.
    definite = _near(fit) >= MIN_DEFINITE or probability_within(fit.covariance, *VAGUE) >= MIN_DEFINITE
    return None if definite else Status.AMBIGUOUS


def against(fit: Fit) -> Status:
    """The strongest evidence against a fit."""
    nothing, body = fit.evidence.nothing, max(fit.evidence.body, fit.resized)
    if -fit.lead > max(body, nothing):
        return Status.AMBIGUOUS
    if body > nothing:
        return Status.OTHER_OBJECT
    if any(contradicting(fit)):
        return Status.INCONSISTENT_VIEWS
    return Status.POOR_FIT if supporters(fit) else Status.TOO_FEW_PIXELS


def nearness(covariance: FloatArray, single: bool) -> float:
    """Probability that a pose is within 5 mm and 5° of the truth if it is the object's.

    single: whether it rests on one camera.
    """
    return _by_cameras(probability_within(covariance, *NEAR), single)


def _by_cameras(near: float, single: bool) -> float:
    """`nearness`, given what follows from the covariance alone."""
    factor = SINGLE if single else 1.0
    return factor * near / (factor * near + 1.0 - near)


@_once
def _near(fit: Fit) -> float:
    """Probability that a fit is that close by its covariance alone."""
    return probability_within(fit.covariance, *NEAR)


def fits(fit: Fit) -> float:
    """Probability that the calibration, as far as it was judged, leaves the pose within 5 mm."""
    return 1.0 if fit.disagreement is None else probably_fits(fit.disagreement, supporters(fit))


@_once
def apparent(fit: Fit) -> float:
    """Confidence of a fit if the calibration is as good as its files state."""
    return trust(fit) * _by_cameras(_near(fit), alone(fit))


def confidence(fit: Fit) -> float:
    """Probability that the pose is within 5 mm and 5° of the truth: equation (21) of docs/how-it-works.md."""
    return fits(fit) * apparent(fit)
