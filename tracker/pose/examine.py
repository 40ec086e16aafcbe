"""Asks each camera by itself where it sees the object, once a pose was found."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from tracker.conventions import FloatArray
from tracker.geometry import so3
from tracker.pose.agreement import disagreement
from tracker.pose.estimate import FAR_REACHES, PoseEstimator
from tracker.pose.fit import Fit, OwnViews
from tracker.pose.hypotheses import align
from tracker.pose.sight import Sight
from tracker.pose.solve.schedule import FOLLOWING
from tracker.pose.start import Lag
from tracker.pose.witness import EXPECTED

ODD, FEW_ODD = 1.2, 0.6
"""Pixels of the label map in the object's colours beside or on the wrong face, over the pieces of its edges,
from which a camera may see it elsewhere; and from which one may that can use few edges."""

USED = 8.0
"""Weight of the pieces of edges on which a camera's own view must rest."""

SHOWN = 30, 0.15
"""Least number of pixels in the object's colours, and least share of those expected, for a camera that can
use few edges to be asked."""

BETTER = 20, 0.1
"""By how many pixels, and by which share of those expected, its own pose must explain the label map better:
a camera alone has many poses that do so a little."""

TURNED = math.radians(12)
"""Turn beyond which its own pose is another optimum."""


def examined(estimator: PoseEstimator, sight: Sight, fit: Fit, lag: Lag | None = None) -> Fit:
    """The fit with a judgement of the calibration, or without where fewer than two cameras see it.

    Cameras whose label maps show the object beside the pose are asked by a search of their own, since their
    edges lie beyond the strips.

    Args:
        estimator: that found the pose.
        sight: what it was found in, with the cameras that were left out.
        fit: the pose.
        lag: how far the pictures lag behind, None where they were taken at once.
    """
    own = fit.own
    if own is None:
        used = sight.without(*fit.left_out)
        own = estimator.refine(used, fit.rotation, fit.position, FOLLOWING, fit.end, lag, ask=True).own
    assert own is not None
    views = OwnViews(*(column.copy() for column in own))
    for c in _astray(sight, fit, own):
        other = _own_search(estimator, sight, fit, c, lag)
        if other is not None:
            views.information[c], views.moved[c], views.inliers[c] = other
    if np.count_nonzero(views.information[:, 0, 0] > 0.0) < 2:
        return replace(fit, own=views)
    lenses = estimator.small
    found = disagreement(views, lenses["rotation"], lenses["position"], fit.position, estimator.box.radius)
    return replace(fit, own=views, disagreement=found)


def _astray(sight: Sight, fit: Fit, own: OwnViews) -> list[int]:
    """Cameras that may see the object elsewhere."""
    result = []
    for c in np.flatnonzero(sight.used).tolist():
        seen = fit.cameras[c]
        if seen["predicted"] < EXPECTED:
            continue
        odd = int(seen["extra"]) + int(seen["wrong"])
        shown = odd + int(seen["agree"]) > max(SHOWN[0], SHOWN[1] * seen["predicted"])
        few = own.inliers[c] < USED and shown
        if c in fit.left_out or odd > (FEW_ODD if few else ODD) * seen["expected"]:
            result.append(c)
    return result


def _own_search(
    estimator: PoseEstimator, sight: Sight, fit: Fit, c: int, lag: Lag | None
) -> tuple[FloatArray, FloatArray, float] | None:
    """One camera's part of OwnViews, as it is found by itself near the pose, if it is."""
    only = sight.without(*(k for k in range(len(sight.used)) if k != c))
    rotations, positions = fit.rotation[None].copy(), fit.position[None].copy()
    align.try_hypotheses(
        estimator.small, only.labels, only.used, estimator.box.half, estimator.box.face_labels,
        rotations, positions, FAR_REACHES, np.empty(1),
    )  # fmt: skip
    other = estimator.refine(only, rotations[0], positions[0], start=fit.end, lag=lag, ask=True)
    if other.own is None or other.own.inliers[c] < USED:
        return None
    turned = so3.log(other.rotation @ fit.rotation.T)
    gain = _explained(other, c) - _explained(fit, c)
    if np.linalg.norm(turned) > TURNED or gain <= max(BETTER[0], BETTER[1] * fit.cameras["predicted"][c]):
        return None
    moved = other.own.moved[c] + np.concatenate([other.position - fit.position, turned])
    return other.own.information[c], moved, float(other.own.inliers[c])


def _explained(fit: Fit, c: int) -> int:
    """Pixels of a camera's label map that speak for a fit, less those against it."""
    seen = fit.cameras[c]
    return int(seen["agree"]) - int(seen["extra"]) - int(seen["wrong"])
