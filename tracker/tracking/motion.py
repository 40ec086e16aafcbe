"""A pose over time: prediction and measurements fused by an error-state Kalman filter with several motions.

An object on the platform lies still most of the time, is pushed slowly, or is thrown about. One filter
cannot smooth the first without lagging in the last; so one runs for each kind of motion, and how well each
predicts the measurements tells which to believe (interacting multiple models: Blom and Bar-Shalom 1988).

The state is position p, rotation R and velocity (v, ω) along world axes; its error is
(δp, δθ, δv, δω) with p = p̂ + δp, R = exp(δθ) R̂ [m, rad, m/s, rad/s].
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tracker.compiled import compiled
from tracker.conventions import Array, FloatArray
from tracker.geometry import so3

STATE = 12
"""Size of the error of the state."""


class Motions(NamedTuple):
    """M kinds of motion, what they do in time, and how they follow each other."""

    still: Array
    """(M,) whether the velocity is zero."""
    walk: FloatArray
    """(M, 2) standard deviation of place [m/√s] and rotation [rad/√s] beyond the velocity."""
    push: FloatArray
    """(M, 2) acceleration, as white noise: [m/s^1.5] and [rad/s^1.5]."""
    lasting: FloatArray
    """(M,) mean time that a motion of a kind lasts [s]."""


MOTIONS = Motions(
    still=np.array([True, False, False]),
    walk=np.array([[5e-6, 1.2e-4], [3e-4, 6e-3], [1e-3, 2e-2]]),
    push=np.array([[0.0, 0.0], [0.05, 1.0], [1.0, 12.0]]),
    lasting=np.array([2.0, 1.0, 0.5]),
)
"""At rest, pushed or carried, thrown or dropped."""

DECAY = 0.4
"""Time in which an unseen object's velocity falls to 1/e [s]: what moves soon stops."""

START_STD = 0.3, 4.0
"""Standard deviation of a new object's velocity [m/s], [rad/s]."""

CONSTANT = 0.8
"""Share of a measurement's covariance that does not average away over time: errors of the calibration and of
the object's model are the same in each image."""


@compiled
def _difference(p1, r1, v1, p0, r0, v0, out):  # type: ignore[no-untyped-def]
    """Out (12,) = error of state 0 that makes it state 1."""
    out[:3] = p1 - p0
    so3.log_into(r1 @ r0.T, out[3:6])
    out[6:] = v1 - v0


@compiled
def moved(p, r, v, error):  # type: ignore[no-untyped-def]
    """Move a state, in place, by an error (12,)."""
    turn = np.empty((3, 3))
    so3.exp_into(error[3:6], turn)
    p += error[:3]
    r[:] = turn @ r
    v += error[6:]


@compiled
def mix(weights, transition, p, r, v, covariance):  # type: ignore[no-untyped-def]
    """Let the kinds of motion change into each other, in place; transition (M, M) from row to column.

    See equation (23) of docs/how-it-works.md.
    """
    kinds = len(weights)
    new = transition.T @ weights
    old_p, old_r, old_v, old = p.copy(), r.copy(), v.copy(), covariance.copy()
    errors, mean = np.empty((kinds, STATE)), np.empty(STATE)
    for j in range(kinds):
        mean[:] = 0.0
        for i in range(kinds):
            share = transition[i, j] * weights[i] / new[j]
            _difference(old_p[i], old_r[i], old_v[i], old_p[j], old_r[j], old_v[j], errors[i])
            mean += share * errors[i]
        covariance[j] = 0.0
        for i in range(kinds):
            share = transition[i, j] * weights[i] / new[j]
            off = errors[i] - mean
            covariance[j] += share * (old[i] + np.outer(off, off))
        moved(p[j], r[j], v[j], mean)
    weights[:] = new


@compiled
def predict(dt, motions, p, r, v, covariance):  # type: ignore[no-untyped-def]
    """Move every kind's state and covariance on by dt [s], in place.

    See equation (22) of docs/how-it-works.md.
    """
    turn, step = np.empty((3, 3)), np.eye(STATE)
    for k in range(len(p)):
        if motions.still[k]:
            v[k] = 0.0
            covariance[k, 6:, :] = 0.0
            covariance[k, :, 6:] = 0.0
        else:
            so3.exp_into(dt * v[k, 3:], turn)
            p[k] += dt * v[k, :3]
            r[k] = turn @ r[k]
            step[3:6, 3:6] = turn
            for i in range(6):
                step[i, 6 + i] = dt
            covariance[k] = step @ covariance[k] @ step.T
        for i in range(6):
            kind = 0 if i < 3 else 1
            walk, push = motions.walk[k, kind] ** 2, motions.push[k, kind] ** 2
            covariance[k, i, i] += walk * dt + push * dt**3 / 3.0
            covariance[k, i, 6 + i] += push * dt**2 / 2.0
            covariance[k, 6 + i, i] += push * dt**2 / 2.0
            covariance[k, 6 + i, 6 + i] += push * dt


@compiled
def update(position, rotation, noise, weights, p, r, v, covariance):  # type: ignore[no-untyped-def]
    """Take a measurement with covariance `noise` (6, 6) into every kind's state, in place.

    See equation (24) of docs/how-it-works.md.
    Returns the squared Mahalanobis distance of the measurement from the likeliest kind's prediction.
    """
    kinds = len(weights)
    likelihood, distances = np.empty(kinds), np.empty(kinds)
    innovation = np.empty(6)
    for k in range(kinds):
        innovation[:3] = position - p[k]
        so3.log_into(rotation @ r[k].T, innovation[3:])
        spread = covariance[k, :6, :6] + noise
        gain = np.linalg.solve(spread, covariance[k, :6, :].copy()).T
        distances[k] = innovation @ np.linalg.solve(spread, innovation)
        likelihood[k] = -0.5 * distances[k] - 0.5 * np.log(np.linalg.det(spread * 1e6))
        moved(p[k], r[k], v[k], gain @ innovation)
        keep = np.eye(STATE)
        keep[:, :6] -= gain
        # Joseph's form keeps it symmetric and positive.
        covariance[k] = keep @ covariance[k] @ keep.T + gain @ noise @ gain.T
    best = np.argmax(likelihood + np.log(np.maximum(weights, 1e-12)))
    weights *= np.exp(likelihood - likelihood.max())
    weights /= weights.sum()
    weights[:] = np.maximum(weights, 1e-6)
    weights /= weights.sum()
    return distances[best]


@compiled
def combine(weights, p, r, v, covariance, error, whole):  # type: ignore[no-untyped-def]
    """All kinds together: error (12,) from the likeliest kind, and whole (12, 12); returns that kind.

    See equation (25) of docs/how-it-works.md.
    """
    best = int(np.argmax(weights))
    kinds = len(weights)
    errors = np.empty((kinds, STATE))
    error[:] = 0.0
    for k in range(kinds):
        _difference(p[k], r[k], v[k], p[best], r[best], v[best], errors[k])
        error += weights[k] * errors[k]
    whole[:] = 0.0
    for k in range(kinds):
        off = errors[k] - error
        whole += weights[k] * (covariance[k] + np.outer(off, off))
    return best
