"""A pose over time: prediction and measurements fused by an error-state Kalman filter with several motions.

An object on the platform lies still most of the time, is pushed slowly, or is thrown about. One filter
cannot smooth the first without lagging in the last; so one runs for each kind of motion, and how well each
predicts the measurements tells which to believe (interacting multiple models: Blom and Bar-Shalom 1988).

The state is position p, rotation R and velocity (v, ω) along world axes; its error is
(δp, δθ, δv, δω) with p = p̂ + δp, R = exp(δθ) R̂ [m, rad, m/s, rad/s].
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from tracker.compiled import compiled
from tracker.conventions import Array, FloatArray
from tracker.geometry import so3
from tracker.geometry.linear import congruence, factorise, product, substitute

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

KINDS = "at rest", "pushed or carried", "thrown or dropped"
"""Their names."""

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
    turned = np.empty((3, 3))
    product(r1, r0.T, turned)
    so3.log_into(turned, out[3:6])
    for i in range(3):
        out[i] = p1[i] - p0[i]
    for i in range(6):
        out[6 + i] = v1[i] - v0[i]


@compiled
def moved(p, r, v, error):  # type: ignore[no-untyped-def]
    """Move a state, in place, by an error (12,)."""
    turn, turned = np.empty((3, 3)), np.empty((3, 3))
    so3.exp_into(error[3:6], turn)
    product(turn, r, turned)
    for i in range(3):
        p[i] += error[i]
        for k in range(3):
            r[i, k] = turned[i, k]
    for i in range(6):
        v[i] += error[6 + i]


@compiled
def _spread(p, r, v, weights, to, errors, mean):  # type: ignore[no-untyped-def]
    """Errors (M, 12) of state `to` that make it each of M states, and their mean (12,) under weights (M,)."""
    mean[:] = 0.0
    for k in range(len(weights)):
        _difference(p[k], r[k], v[k], p[to], r[to], v[to], errors[k])
        for i in range(STATE):
            mean[i] += weights[k] * errors[k, i]


@compiled
def _pool(covariance, weights, errors, mean, out):  # type: ignore[no-untyped-def]
    """Out (12, 12): covariance of a mixture of states with covariances (M, 12, 12)."""
    out[:] = 0.0
    for k in range(len(weights)):
        for i in range(STATE):
            a = errors[k, i] - mean[i]
            for j in range(STATE):
                out[i, j] += weights[k] * (covariance[k, i, j] + a * (errors[k, j] - mean[j]))


@compiled
def mix(weights, transition, p, r, v, covariance):  # type: ignore[no-untyped-def]
    """Let the kinds of motion change into each other, in place; transition (M, M) from row to column.

    See equation (23) of docs/how-it-works.md.
    """
    kinds = len(weights)
    old_p, old_r, old_v, old = p.copy(), r.copy(), v.copy(), covariance.copy()
    errors, mean = np.empty((kinds, STATE)), np.empty(STATE)
    new, shares = np.empty(kinds), np.empty(kinds)
    for j in range(kinds):
        new[j] = 0.0
        for i in range(kinds):
            new[j] += transition[i, j] * weights[i]
        for i in range(kinds):
            shares[i] = transition[i, j] * weights[i] / new[j]
        _spread(old_p, old_r, old_v, shares, j, errors, mean)
        _pool(old, shares, errors, mean, covariance[j])
        moved(p[j], r[j], v[j], mean)
    for j in range(kinds):
        weights[j] = new[j]


@compiled
def predict(dt, motions, p, r, v, covariance):  # type: ignore[no-untyped-def]
    """Move every kind's state and covariance on by dt [s], in place.

    See equation (22) of docs/how-it-works.md.
    """
    turn, step, before, turned = np.empty((3, 3)), np.eye(STATE), np.empty((STATE, STATE)), np.empty((3, 3))
    for k in range(len(p)):
        if motions.still[k]:
            v[k] = 0.0
            covariance[k, 6:, :] = 0.0
            covariance[k, :, 6:] = 0.0
        else:
            so3.exp_into(dt * v[k, 3:], turn)
            product(turn, r[k], turned)
            for i in range(3):
                p[k, i] += dt * v[k, i]
                for j in range(3):
                    r[k, i, j] = turned[i, j]
                    step[3 + i, 3 + j] = turn[i, j]
            for i in range(6):
                step[i, 6 + i] = dt
            for i in range(STATE):
                for j in range(STATE):
                    before[i, j] = covariance[k, i, j]
            covariance[k] = 0.0
            congruence(step, before, covariance[k])
        for i in range(6):
            kind = 0 if i < 3 else 1
            walk, push = motions.walk[k, kind] ** 2, motions.push[k, kind] ** 2
            covariance[k, i, i] += walk * dt + push * dt**3 / 3.0
            covariance[k, i, 6 + i] += push * dt**2 / 2.0
            covariance[k, 6 + i, i] += push * dt**2 / 2.0
            covariance[k, 6 + i, 6 + i] += push * dt


@compiled
def _correct(innovation, noise, p, r, v, covariance):  # type: ignore[no-untyped-def]
    """Kalman's update of one state in place; returns the innovation's log likelihood up to a constant."""
    spread, lower, gain = np.empty((6, 6)), np.zeros((6, 6)), np.empty((STATE, 6))
    keep, before, error, pull = np.eye(STATE), covariance.copy(), np.empty(STATE), np.empty(6)
    for i in range(6):
        for j in range(6):
            spread[i, j] = covariance[i, j] + noise[i, j]
    if not factorise(spread, lower):
        return -np.inf
    substitute(lower, innovation, pull)
    likelihood = 0.0
    for i in range(6):
        likelihood -= 0.5 * innovation[i] * pull[i] + math.log(lower[i, i])
    for i in range(STATE):
        substitute(lower, before[i, :6], gain[i])
        error[i] = 0.0
        for j in range(6):
            error[i] += gain[i, j] * innovation[j]
            keep[i, j] -= gain[i, j]
    moved(p, r, v, error)
    # Joseph's form keeps it symmetric and positive.
    covariance[:] = 0.0
    congruence(keep, before, covariance)
    congruence(gain, noise, covariance)
    return likelihood


@compiled
def update(position, rotation, noise, weights, p, r, v, covariance):  # type: ignore[no-untyped-def]
    """Take a measurement with covariance `noise` (6, 6) into every kind's state, in place.

    See equation (24) of docs/how-it-works.md.
    """
    kinds = len(weights)
    likelihood, innovation, turned = np.empty(kinds), np.empty(6), np.empty((3, 3))
    for k in range(kinds):
        for i in range(3):
            innovation[i] = position[i] - p[k, i]
        product(rotation, r[k].T, turned)
        so3.log_into(turned, innovation[3:])
        likelihood[k] = _correct(innovation, noise, p[k], r[k], v[k], covariance[k])
    best = likelihood[0]
    for k in range(kinds):
        best = max(best, likelihood[k])
    total = 0.0
    for k in range(kinds):
        weights[k] *= math.exp(likelihood[k] - best)
        total += weights[k]
    rest = 0.0
    for k in range(kinds):
        # A kind that is out of the question now may come back.
        weights[k] = max(weights[k] / total, 1e-6)
        rest += weights[k]
    for k in range(kinds):
        weights[k] /= rest


@compiled
def combine(weights, p, r, v, covariance, error, whole):  # type: ignore[no-untyped-def]
    """All kinds together: error (12,) from the likeliest kind, and whole (12, 12); returns that kind.

    See equation (25) of docs/how-it-works.md.
    """
    best = 0
    for k in range(len(weights)):
        if weights[k] > weights[best]:
            best = k
    errors = np.empty((len(weights), STATE))
    _spread(p, r, v, weights, best, errors, error)
    _pool(covariance, weights, errors, error, whole)
    return best
