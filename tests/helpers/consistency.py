"""Whether covariances are as large as the errors: the mean normalised squared error (NEES) and its limits."""

import numpy as np
from scipy.stats import chi2

from tracker.conventions import Array, FloatArray
from tracker.geometry import so3

FACTORS = [(1.0, True), (2.0, False), (0.5, False)]
"""Factors on a covariance that is right, and whether it is consistent then: for parametrised tests."""


def pose_error(position: Array, rotation: Array, true_position: Array, true_rotation: Array) -> FloatArray:
    """(6,) of a position (3,) and a rotation (3, 3) against the true ones [m, rad]."""
    return np.concatenate([position - true_position, so3.log(rotation @ true_rotation.T)])


def nees(error: FloatArray, covariance: FloatArray) -> float:
    """Squared error (n,) in units of its covariance (n, n)."""
    return float(error @ np.linalg.solve(covariance, error))


def consistent(found: FloatArray, factor: float = 1.0) -> bool:
    """Whether the mean of NEES (count,) is as covariances that are `factor` times as large would have it.

    Independent errors are consistent in 998 of 1000 cases.

    Raises:
        ValueError: the errors are too few to tell a covariance that is off by a factor of two.
    """
    count = len(found)
    low, high = chi2.ppf([0.001, 0.999], count * 6) / count
    if high > 2 * low:
        raise ValueError(f"{count} errors: limits {low:.1f} and {high:.1f} hold a factor of two")
    return bool(low < np.mean(found) / factor < high)
