"""Whether a fit is the object, and how probably it is right.

Each camera is a witness: it supports a pose, it contradicts it, or it cannot tell.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from tracker.conventions import FloatArray
from tracker.geometry.probability import probability_within
from tracker.pose.agreement import probably_fits
from tracker.pose.fit import SEEN, Fit
from tracker.pose.result import Status

EXPECTED = 20
"""Pixels of its label map that the object must fill for a camera to have a say."""

SUPPORT = 10, 0.1
"""Least number and least share of these pixels that show the right face where a camera supports a pose."""

CONTRADICTION = 30, 0.15
"""Least number, as a share of the pixels expected, too, of pixels in the object's colours outside it, where
a camera that does not support a pose contradicts it: it sees the object somewhere else."""

MIN_VIEW = 4.0
"""Weight of the pieces of edges on which a camera must agree to count as seeing the object."""

_INLIERS, _PREDICTED = ((SEEN.names or ()).index(name) for name in ("inliers", "predicted"))

MIN_AGREE = 30
"""Pixels of the label maps that must show the face the pose predicts."""

MIN_EXPLAINED = 0.15
"""Share of the object's expected pixels that must show the predicted face; the rest may be hidden."""

MAX_WRONG = 0.5
"""Share of face-coloured pixels inside the outline that may show another face."""

MIN_INLIERS = 5.0
"""Weight of edges' pieces that must lie on edges."""

MIN_LEAD = 0.7
"""Log odds by which a fit must lead over a different pose, or the answer is ambiguous."""

MIN_TRUST = 0.2
"""Probability that the fit sits on the object below which there had better be no pose."""

VAGUE, MIN_DEFINITE = (0.02, math.radians(5)), 0.5
"""The pose must be this close to the truth [m, rad] with this probability, or many poses would do."""


class Witnesses(NamedTuple):
    """What the cameras together say of a pose."""

    supporting: tuple[bool, ...]
    contradicting: tuple[bool, ...]
    worst_wrong: float
    """Largest share of face-coloured pixels that show another face than expected, of a supporter."""
    blind: int
    """Supporters that see no edges."""

    @property
    def lonely(self) -> bool:
        """Whether at most one camera sees the object there, and another one elsewhere."""
        return sum(self.supporting) < 2 and any(self.contradicting)


@functools.lru_cache(maxsize=32)
def witnesses(fit: Fit) -> Witnesses:
    """What the cameras say of a fit."""
    supporting, contradicting = [], []
    worst, blind = 0.0, 0
    for _, _, inliers, _, _, predicted, agree, _, wrong, extra, elsewhere in fit.rows:
        speaks = predicted >= EXPECTED
        supports = speaks and agree >= max(SUPPORT[0], SUPPORT[1] * predicted) and wrong <= agree
        outside = extra + elsewhere + wrong
        supporting.append(supports)
        contradicting.append(
            speaks and not supports and outside >= max(CONTRADICTION[0], CONTRADICTION[1] * predicted)
        )
        if supports:
            worst = max(worst, wrong / (agree + wrong))
            blind += inliers < MIN_VIEW
    return Witnesses(tuple(supporting), tuple(contradicting), worst, blind)


@functools.lru_cache(maxsize=32)
def features(fit: Fit) -> Mapping[str, float]:
    """What the confidence is computed from; all small for a perfect fit in full view."""
    extra = fit.total("extra")
    predicted = max(fit.total("predicted"), 1.0)
    said = witnesses(fit)
    usable, inliers = fit.total("usable"), fit.total("inliers")
    rms = math.sqrt(fit.total("squares") / max(inliers, 1e-9))
    return {
        "wrong": math.sqrt(said.worst_wrong),
        "extra": math.sqrt(extra / predicted),
        "unusable": 1.0 - usable / max(fit.total("expected"), 1.0),
        "outliers": 1.0 - inliers / max(usable, 1.0),
        "rms": math.log(max(rms, 0.05) / 0.1),
        "contradicted": float(sum(said.contradicting)),
        "blind": float(said.blind),
        "single": float(sum(said.supporting) < 2),
    }


def alone(fit: Fit) -> bool:
    """Whether the pose rests on what one camera sees."""
    return sum(row[_INLIERS] >= MIN_VIEW for row in fit.rows) < 2


def supporters(fit: Fit) -> int:
    """How many cameras see the object where the fit has it."""
    return sum(witnesses(fit).supporting)


def unanimous(fit: Fit) -> bool:
    """Whether all cameras in whose pictures the object should be see it where the fit has it."""
    return supporters(fit) == sum(row[_PREDICTED] > 0 for row in fit.rows)


def possible(fit: Fit) -> bool:
    """Whether the object is in the arena."""
    return fit.inside


@functools.lru_cache(maxsize=32)
def refusal(fit: Fit) -> Status | None:
    """Why the fit is not accepted; None where it is."""
    found = features(fit)
    if fit.total("agree") < max(MIN_AGREE, MIN_EXPLAINED * fit.total("predicted")):
        return Status.TOO_FEW_PIXELS
    agree, wrong = fit.total("agree"), fit.total("wrong")
    if wrong > MAX_WRONG * (agree + wrong) or found["extra"] ** 2 > 0.5:
        return Status.INCONSISTENT_VIEWS
    if not possible(fit):
        # One camera alone takes what hides the object's edges for them, and puts it too far away.
        return Status.AMBIGUOUS if alone(fit) else Status.INCONSISTENT_VIEWS
    if fit.total("inliers") < MIN_INLIERS or not np.isfinite(fit.covariance).all():
        return Status.POOR_FIT
    if fit.lead < MIN_LEAD:
        return Status.AMBIGUOUS
    if trust(fit) < MIN_TRUST:
        return Status.POOR_FIT
    return Status.AMBIGUOUS if probably_near(fit.covariance, VAGUE) < MIN_DEFINITE else None


WEIGHTS = {
    "wrong": -3.82, "extra": -4.29, "unusable": -3.82, "outliers": -4.67, "rms": -0.64, "contradicted": -1.06,
    "blind": -0.99, "single": -1.57,
}  # fmt: skip
"""Weights of the features, none positive, so that no doubt can raise the confidence. Fitted, with the bias,
by scripts/fit_confidence.py on right and wrong fits to rendered scenes."""

BIAS = 6.95

NEAR = 5e-3, math.radians(5)
"""What the confidence promises: the pose is this close to the truth [m, rad]."""


@functools.lru_cache(maxsize=32)
def log_odds(fit: Fit) -> float:
    """Log odds that the fit sits on the object and not in a wrong optimum: a linear model of `features`."""
    return BIAS + sum(WEIGHTS[key] * value for key, value in features(fit).items())


SURE = 2.2
"""Log odds of a fit at which no other hypothesis is tried."""


def sure(fit: Fit) -> bool:
    """Whether a fit in the arena leaves little doubt by itself."""
    return log_odds(fit) > SURE and fit.converged and possible(fit)


MOST_UNUSABLE = 0.5
"""Share of the edges' pieces that show nothing they could be measured by, up to which a fit settles the
matter: one that is turned the wrong way round has edges where there are none."""


def settled(fit: Fit) -> bool:
    """Whether no other hypothesis needs to be tried: one camera alone never settles the matter."""
    return sure(fit) and not alone(fit) and features(fit)["unusable"] <= MOST_UNUSABLE


OUTVOTED = 3.0
"""Log odds by which a pose that one camera sees, and another one elsewhere, is behind."""

EVIDENCE = 0.1
"""Log odds that another piece of an edge in its place adds in comparison with a rival."""


def rank(fit: Fit) -> float:
    """By how much a fit is to be preferred: its log odds, explained pieces of edges, how well it stands.

    A pose that shares most of the object's outline with the right one, slid along an edge or turned by a
    quarter, has clean pieces too, but fewer of them; one that slid into a wrong optimum has rough ones. One
    that another camera contradicts is behind those that two see.
    """
    pieces = fit.total("inliers")
    explained = EVIDENCE * pieces / (1.0 + max(features(fit)["rms"], 0.0))
    lonely = OUTVOTED if witnesses(fit).lonely else 0.0
    return log_odds(fit) + explained + fit.stands - lonely


def probably_near(covariance: FloatArray, limits: tuple[float, float] = NEAR) -> float:
    """Probability that a pose with this covariance (6, 6) is within limits [m, rad] of the truth."""
    return probability_within(covariance, *limits)


LONELY = 0.35
"""Share of the confidence that is left where one camera sees the object and another one sees it elsewhere:
nobody can tell which of them is wrong. Such a pose is doubted, not refused."""


def trust(fit: Fit) -> float:
    """Probability that the fit sits on the object, at whatever accuracy; a close rival halves it at most."""
    return 1.0 / (1.0 + math.exp(-log_odds(fit))) / (1.0 + math.exp(-fit.lead))


def fits(fit: Fit) -> float:
    """Probability that the calibration, as far as it was judged, leaves the pose within 5 mm."""
    return 1.0 if fit.disagreement is None else probably_fits(fit.disagreement)


@functools.lru_cache(maxsize=32)
def apparent(fit: Fit) -> float:
    """The confidence of a fit if the calibration is right as far as its files state."""
    doubt = LONELY if witnesses(fit).lonely else 1.0
    return doubt * trust(fit) * probably_near(fit.covariance)


def confidence(fit: Fit) -> float:
    """Probability that the pose is within 5 mm and 5° of the truth: equation (21) of docs/how-it-works.md."""
    return fits(fit) * apparent(fit)
