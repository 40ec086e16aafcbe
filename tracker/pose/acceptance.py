"""Whether a fit is the object, and how probably it is right."""

from __future__ import annotations

import math

import numpy as np

from tracker.pose import align
from tracker.pose.estimate import RIVAL, Fit
from tracker.pose.result import Status

MIN_AGREE = 30
"""Pixels of the label maps that must show the face the pose predicts."""

MIN_EXPLAINED = 0.2
"""Share of the object's expected pixels that must show the predicted face; the rest may be hidden."""

MAX_WRONG = 0.3
"""Share of face-coloured pixels inside the outline that may show another face."""

MIN_INLIERS = 12.0
"""Weight of edge samples that must lie on edges."""


def features(fit: Fit) -> dict[str, float]:
    """What the confidence is computed from, all near 0 for a perfect fit in full view."""
    counts = fit.counts.sum(axis=0)
    agree, missing = counts[align.AGREE], counts[align.MISSING]
    wrong, extra = counts[align.WRONG], counts[align.EXTRA]
    predicted = max(int(counts[align.PREDICTED]), 1)
    usable, inliers = fit.samples[:, 1].sum(), fit.samples[:, 2].sum()
    rms = math.sqrt(fit.samples[:, 3].sum() / max(inliers, 1e-9))
    return {
        "hidden": float(missing / predicted),
        "wrong": float(wrong / max(agree + wrong, 1)),
        "extra": float(extra / predicted),
        "outliers": float(1 - inliers / max(usable, 1.0)),
        "rms": rms,
        "rival": fit.rival,
    }


def refusal(fit: Fit) -> Status | None:
    """Why the fit is not accepted; None where it is."""
    counts = fit.counts.sum(axis=0)
    found = features(fit)
    if counts[align.AGREE] < MIN_AGREE or found["hidden"] > 1 - MIN_EXPLAINED:
        return Status.TOO_FEW_PIXELS
    if found["wrong"] > MAX_WRONG or found["extra"] > 0.5:
        return Status.INCONSISTENT_VIEWS
    if fit.samples[:, 2].sum() < MIN_INLIERS or not np.isfinite(fit.covariance).all():
        return Status.POOR_FIT
    if fit.rival > RIVAL:
        return Status.AMBIGUOUS
    return None


WEIGHTS = {"hidden": -3.0, "wrong": -12.0, "extra": -5.0, "outliers": -5.0, "rms": -3.0, "rival": -2.0}
BIAS = 9.0


def confidence(fit: Fit) -> float:
    """Probability that the pose is within 5 mm and 5° of the truth: a logistic model of `features`."""
    total = BIAS + sum(WEIGHTS[key] * value for key, value in features(fit).items())
    return 1.0 / (1.0 + math.exp(-total))
