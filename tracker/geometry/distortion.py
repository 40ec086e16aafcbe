"""Lens distortion: OpenCV's model of 5, 8, 12 or 14 coefficients.

From normalised coordinates x = X/Z, y = Y/Z with r² = x² + y²:
    radial = (1 + k1 r² + k2 r⁴ + k3 r⁶) / (1 + k4 r² + k5 r⁴ + k6 r⁶)
    x' = x radial + 2 p1 x y + p2 (r² + 2 x²) + s1 r² + s2 r⁴
    y' = y radial + p1 (r² + 2 y²) + 2 p2 x y + s3 r² + s4 r⁴
and, if the sensor is tilted by τx, τy, the homography of `tilt` applied to (x', y').
"""

from __future__ import annotations

import numpy as np

from tracker.conventions import FloatArray

COUNTS = (5, 8, 12, 14)
"""Numbers of coefficients: k1 k2 p1 p2 k3, k4 k5 k6, s1 s2 s3 s4, τx τy."""

_NEWTON_ITERATIONS = 30
_NEWTON_TOLERANCE = 1e-12


def all_coefficients(coefficients: FloatArray) -> FloatArray:
    """Return all 14 coefficients, with 0 for those not given."""
    result = np.zeros(COUNTS[-1])
    result[: len(coefficients)] = coefficients
    return result


def tilt(coefficients: FloatArray) -> FloatArray:
    """Return the homography (3, 3) from distorted coordinates to the tilted sensor; identity if untilted."""
    angles = all_coefficients(coefficients)[12:]
    (sx, sy), (cx, cy) = np.sin(angles), np.cos(angles)
    about_x = np.array([[1, 0, 0], [0, cx, sx], [0, -sx, cx]])
    about_y = np.array([[cy, 0, -sy], [0, 1, 0], [sy, 0, cy]])
    turned = about_y @ about_x
    (_, _, a), (_, _, b), (_, _, c) = turned
    return np.asarray(np.array([[c, 0, -a], [0, c, -b], [0, 0, 1]]) @ turned)


def distort(normalized: FloatArray, coefficients: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return distorted coordinates (N, 2) of normalised ones (N, 2), and their derivatives (N, 2, 2)."""
    k1, k2, p1, p2, k3 = coefficients[:5]
    x, y = normalized[:, 0], normalized[:, 1]
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = 2 * (k1 + r2 * (2 * k2 + r2 * 3 * k3))  # d radial/dx = x · slope
    if len(coefficients) > 5:
        k4, k5, k6 = coefficients[5:8]
        below = 1 + r2 * (k4 + r2 * (k5 + r2 * k6))
        radial = radial / below
        slope = (slope - radial * 2 * (k4 + r2 * (2 * k5 + r2 * 3 * k6))) / below
    bent = np.empty_like(normalized)
    bent[:, 0] = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    bent[:, 1] = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    derivative = np.empty((len(normalized), 2, 2))
    derivative[:, 0, 0] = radial + x * x * slope + 2 * p1 * y + 6 * p2 * x
    derivative[:, 1, 1] = radial + y * y * slope + 6 * p1 * y + 2 * p2 * x
    derivative[:, 0, 1] = derivative[:, 1, 0] = x * y * slope + 2 * p1 * x + 2 * p2 * y
    if len(coefficients) > 8:
        s1, s2, s3, s4 = coefficients[8:12]
        bent += np.stack([r2 * (s1 + r2 * s2), r2 * (s3 + r2 * s4)], axis=1)
        along = 2 * np.stack([s1 + 2 * r2 * s2, s3 + 2 * r2 * s4], axis=1)
        derivative += along[:, :, None] * normalized[:, None, :]
    if len(coefficients) > 12:
        homography = tilt(coefficients)
        seen = bent @ homography[:, :2].T + homography[:, 2]
        bent = seen[:, :2] / seen[:, 2:]
        rows = homography[:2, :2] - bent[:, :, None] * homography[2, :2]
        derivative = (rows / seen[:, 2, None, None]) @ derivative
    return bent, derivative


def undistort(target: FloatArray, coefficients: FloatArray) -> FloatArray:
    """Invert `distort` for targets (N, 2) by Newton's method; NaN if it finds no solution before the fold."""
    solution = target.copy()
    with np.errstate(all="ignore"):  # diverging rows become NaN
        for _ in range(_NEWTON_ITERATIONS):
            value, slope = distort(solution, coefficients)
            error = value - target
            (a, b), (c, d) = slope[:, 0].T, slope[:, 1].T
            determinant = a * d - b * c
            solution[:, 0] -= (d * error[:, 0] - b * error[:, 1]) / determinant
            solution[:, 1] -= (a * error[:, 1] - c * error[:, 0]) / determinant
            if np.abs(error).max(initial=0) < _NEWTON_TOLERANCE:
                break
        good = (np.abs(error).max(axis=1) < 100 * _NEWTON_TOLERANCE) & (determinant > 0) & (a + d > 0)
    solution[~good] = np.nan
    return solution
