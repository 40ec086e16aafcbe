"""Whether a fit is the object, and how probably it is right."""

from __future__ import annotations

import math

import numpy as np

from tracker.pose import align, contour
from tracker.pose.fit import Fit
from tracker.pose.result import Status

MIN_AGREE = 30
"""Pixels of the label maps that must show the face the pose predicts."""

MIN_EXPLAINED = 0.2
"""Share of the object's expected pixels that must show the predicted face; the rest may be hidden."""

MAX_WRONG = 0.3
"""Share of face-coloured pixels inside the outline that may show another face."""

MIN_INLIERS = 12.0
"""Weight of edge samples that must lie on edges."""

MIN_LEAD = 0.7
"""Log odds by which a fit must lead over a different pose, or the answer is ambiguous."""


def features(fit: Fit) -> dict[str, float]:
    """What the confidence is computed from; all small for a perfect fit in full view."""
    counts = fit.counts.sum(axis=0)
    agree, missing = float(counts[align.AGREE]), float(counts[align.MISSING])
    wrong, extra = float(counts[align.WRONG]), float(counts[align.EXTRA])
    predicted = max(float(counts[align.PREDICTED]), 1.0)
    usable, inliers = fit.samples[:, contour.USABLE].sum(), fit.samples[:, contour.INLIERS].sum()
    std = np.sqrt(np.diag(fit.covariance))
    return {
        "hidden": missing / predicted,
        "wrong": math.sqrt(wrong / max(agree + wrong, 1.0)),
        "extra": math.sqrt(extra / predicted),
        "unusable": 1.0 - float(usable) / max(float(fit.samples[:, contour.EXPECTED].sum()), 1.0),
        "outliers": 1.0 - float(inliers) / max(float(usable), 1.0),
        "rms": math.sqrt(float(fit.samples[:, contour.SQUARES].sum()) / max(float(inliers), 1e-9)),
        "few": 10.0 / math.sqrt(agree + 1.0),
        "position": float(np.log(np.linalg.norm(std[:3]) / 1e-4)),
        "rotation": float(np.log(np.linalg.norm(std[3:]) / 1e-3)),
    }


def refusal(fit: Fit) -> Status | None:
    """Why the fit is not accepted; None where it is."""
    counts = fit.counts.sum(axis=0)
    found = features(fit)
    if counts[align.AGREE] < MIN_AGREE or found["hidden"] > 1 - MIN_EXPLAINED:
        return Status.TOO_FEW_PIXELS
    if found["wrong"] ** 2 > MAX_WRONG or found["extra"] ** 2 > 0.5:
        return Status.INCONSISTENT_VIEWS
    if fit.samples[:, contour.INLIERS].sum() < MIN_INLIERS or not np.isfinite(fit.covariance).all():
        return Status.POOR_FIT
    if fit.lead < MIN_LEAD:
        return Status.AMBIGUOUS
    return None


WEIGHTS = {
    "hidden": -3.0, "wrong": -8.0, "extra": -4.0, "unusable": -2.0, "outliers": -5.0, "rms": -3.0,
    "few": -1.0, "position": 0.0, "rotation": 0.0,
}  # fmt: skip
BIAS = 9.0


def log_odds(fit: Fit) -> float:
    """Log odds that the pose is within 5 mm and 5° of the truth: a linear model of `features`."""
    return BIAS + sum(WEIGHTS[key] * value for key, value in features(fit).items())


def confidence(fit: Fit) -> float:
    """Probability that the pose is within 5 mm and 5° of the truth; a close rival halves it at most."""
    alone = 1.0 / (1.0 + math.exp(-log_odds(fit)))
    return alone / (1.0 + math.exp(-fit.lead))
