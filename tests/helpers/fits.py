"""Fits that no picture was needed for."""

from __future__ import annotations

import math

import numpy as np

from tracker.pose.fit import SEEN, Fit

COVARIANCE = np.diag(np.repeat(np.square([0.3e-3, math.radians(0.3)]), 3))
HOME = np.array([0.02, -0.03, 0.0325])


def made_fit(position=HOME, rotation=None, *, sure=True, cameras=3, covariance=COVARIANCE):
    """A fit as of an object in full view, or with many pixels and pieces of edges that do not agree."""
    seen = np.zeros(3, SEEN)
    fields = {
        "expected": 40.0, "usable": 38.0 if sure else 24.0, "inliers": 36.0 if sure else 12.0,
        "squares": 0.36 if sure else 3.0, "blur": 0.5, "predicted": 410, "agree": 400 if sure else 200,
        "missing": 5 if sure else 120, "wrong": 0 if sure else 60, "extra": 4 if sure else 60,
    }  # fmt: skip
    for name, value in fields.items():
        seen[name][:cameras] = value
    position = np.array(position, dtype=np.float64)
    return Fit(position, np.eye(3) if rotation is None else rotation, covariance, seen, True)
