"""A pose over time: prediction and measurements fused by an error-state Kalman filter with several motions.

An object on the platform lies still most of the time, is pushed slowly, or is thrown about. One filter
cannot smooth the first without lagging in the last; so one runs for each kind of motion, and how well each
predicts the measurements tells which to believe (interacting multiple models: Blom and Bar-Shalom 1988).

The state is position p, rotation R and velocity (v, ω) along world axes; its error is
(δp, δθ, δv, δω) with p = p̂ + δp, R = exp(δθ) R̂ [m, rad, m/s, rad/s].
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numba
import numpy as np

from tracker.conventions import Array, FloatArray

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


@numba.njit(cache=True, nogil=True)
def _exp(vector, out):  # type: ignore[no-untyped-def]
    """Out (3, 3) = exp of a rotation vector (3,)."""
    x, y, z = vector[0], vector[1], vector[2]
    angle = math.sqrt(x * x + y * y + z * z)
    a = 1.0 - angle * angle / 6.0 if angle < 1e-4 else math.sin(angle) / angle
    b = 0.5 - angle * angle / 24.0 if angle < 1e-4 else (1.0 - math.cos(angle)) / (angle * angle)
    out[0, 0], out[1, 1], out[2, 2] = (
        1.0 - b * (y * y + z * z),
        1.0 - b * (x * x + z * z),
        1.0 - b * (x * x + y * y),
    )
    out[0, 1], out[1, 0] = b * x * y - a * z, b * x * y + a * z
    out[0, 2], out[2, 0] = b * x * z + a * y, b * x * z - a * y
    out[1, 2], out[2, 1] = b * y * z - a * x, b * y * z + a * x


@numba.njit(cache=True, nogil=True)
def quaternion(rotation):  # type: ignore[no-untyped-def]
    """Unit quaternion (4,) xyzw, w ≥ 0, of a rotation (3, 3): `so3.quaternion_from_matrix`, compiled."""
    q = np.empty(4)
    trace = rotation[0, 0] + rotation[1, 1] + rotation[2, 2]
    k = 3
    largest = trace
    for i in range(3):
        if rotation[i, i] > largest:
            k, largest = i, rotation[i, i]
    if k == 3:
        q[3] = 1.0 + trace
        for i in range(3):
            a, b = (i + 1) % 3, (i + 2) % 3
            q[i] = rotation[b, a] - rotation[a, b]
    else:
        a, b = (k + 1) % 3, (k + 2) % 3
        q[k] = 1.0 + rotation[k, k] - rotation[a, a] - rotation[b, b]
        q[a] = rotation[a, k] + rotation[k, a]
        q[b] = rotation[b, k] + rotation[k, b]
        q[3] = rotation[b, a] - rotation[a, b]
    length = math.sqrt(np.sum(q * q))
    return q / (length if q[3] >= 0.0 else -length)


@numba.njit(cache=True, nogil=True)
def _log(rotation, out):  # type: ignore[no-untyped-def]
    """Out (3,) = rotation vector of a rotation (3, 3), at any angle."""
    q = quaternion(rotation)
    sine = math.sqrt(q[0] ** 2 + q[1] ** 2 + q[2] ** 2)
    factor = 2.0 if sine < 1e-9 else 2.0 * math.atan2(sine, q[3]) / sine
    for i in range(3):
        out[i] = factor * q[i]


@numba.njit(cache=True, nogil=True)
def _difference(p1, r1, v1, p0, r0, v0, out):  # type: ignore[no-untyped-def]
    """Out (12,) = error of state 0 that makes it state 1."""
    out[:3] = p1 - p0
    _log(r1 @ r0.T, out[3:6])
    out[6:] = v1 - v0


@numba.njit(cache=True, nogil=True)
def _moved(p, r, v, error):  # type: ignore[no-untyped-def]
    """Move a state, in place, by an error (12,)."""
    turn = np.empty((3, 3))
    _exp(error[3:6], turn)
    p += error[:3]
    r[:] = turn @ r
    v += error[6:]


@numba.njit(cache=True, nogil=True)
def mix(weights, transition, p, r, v, covariance):  # type: ignore[no-untyped-def]
    """Let the kinds of motion change into each other, in place; transition (M, M) from row to column."""
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
        _moved(p[j], r[j], v[j], mean)
    weights[:] = new


@numba.njit(cache=True, nogil=True)
def predict(dt, motions, p, r, v, covariance):  # type: ignore[no-untyped-def]
    """Move every kind's state and covariance on by dt [s], in place."""
    turn, step = np.empty((3, 3)), np.eye(STATE)
    for k in range(len(p)):
        if motions.still[k]:
            v[k] = 0.0
            covariance[k, 6:, :] = 0.0
            covariance[k, :, 6:] = 0.0
        else:
            _exp(dt * v[k, 3:], turn)
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


@numba.njit(cache=True, nogil=True)
def update(position, rotation, noise, weights, p, r, v, covariance):  # type: ignore[no-untyped-def]
    """Take a measurement with covariance `noise` (6, 6) into every kind's state, in place.

    Returns the squared Mahalanobis distance of the measurement from the likeliest kind's prediction.
    """
    kinds = len(weights)
    likelihood, distances = np.empty(kinds), np.empty(kinds)
    innovation = np.empty(6)
    for k in range(kinds):
        innovation[:3] = position - p[k]
        _log(rotation @ r[k].T, innovation[3:])
        spread = covariance[k, :6, :6] + noise
        gain = np.linalg.solve(spread, covariance[k, :6, :].copy()).T
        distances[k] = innovation @ np.linalg.solve(spread, innovation)
        likelihood[k] = -0.5 * distances[k] - 0.5 * np.log(np.linalg.det(spread * 1e6))
        _moved(p[k], r[k], v[k], gain @ innovation)
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


@numba.njit(cache=True, nogil=True)
def combine(weights, p, r, v, covariance, error, whole):  # type: ignore[no-untyped-def]
    """All kinds together: error (12,) from the likeliest kind, and whole (12, 12); returns that kind."""
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


@dataclass(frozen=True, eq=False)
class MotionState:
    """Where the object is and how it moves."""

    position: FloatArray
    """(3,) [m]."""
    rotation: FloatArray
    """(3, 3) world_from_object."""
    velocity: FloatArray
    """(6,) of the centre [m/s] and of the rotation [rad/s], along world axes."""
    covariance: FloatArray
    """(12, 12) of (δp, δθ, δv, δω)."""
    at_rest: float
    """Probability that the object does not move."""


class MotionFilter:
    """Fuses measurements of a pose over time."""

    def __init__(self, motions: Motions = MOTIONS) -> None:
        self._motions = motions
        kinds = len(motions.lasting)
        self._weights = np.full(kinds, 1.0 / kinds)
        self._p, self._r, self._v = np.zeros((kinds, 3)), np.zeros((kinds, 3, 3)), np.zeros((kinds, 6))
        self._covariance = np.zeros((kinds, STATE, STATE))
        self._noise = np.zeros((6, 6))
        self._step = -1.0, np.eye(kinds)

    def start(self, position: FloatArray, rotation: FloatArray, noise: FloatArray) -> None:
        """Begin anew with a measurement and its covariance (6, 6)."""
        self._weights[:] = 1.0 / len(self._weights)
        self._p[:], self._r[:], self._v[:] = position, rotation, 0.0
        self._covariance[:] = 0.0
        self._covariance[:, :6, :6] = (1 - CONSTANT) * noise
        for k, still in enumerate(self._motions.still):
            if not still:
                spread = np.repeat(np.square(START_STD), 3)
                self._covariance[k, 6:, 6:] = np.diag(spread)
        self._noise = noise

    def predict(self, dt: float) -> None:
        """Move on by dt [s]."""
        mix(self._weights, self._transition(dt), self._p, self._r, self._v, self._covariance)
        predict(dt, self._motions, self._p, self._r, self._v, self._covariance)

    def _transition(self, dt: float) -> FloatArray:
        """(M, M) probabilities that a kind of motion, by rows, has become another after dt [s]."""
        if dt != self._step[0]:
            kinds = len(self._weights)
            stay = np.exp(-dt / self._motions.lasting)
            others = ((1 - stay) / (kinds - 1))[:, None] * (1 - np.eye(kinds))
            self._step = dt, np.diag(stay) + others
        return self._step[1]

    def slow_down(self, dt: float) -> None:
        """Let the velocity fade, as of an object that is not seen."""
        self._v *= math.exp(-dt / DECAY)

    def update(self, position: FloatArray, rotation: FloatArray, noise: FloatArray) -> float:
        """Take in a measurement with its covariance (6, 6); returns how far it was from expected, squared."""
        self._noise = noise
        white = (1 - CONSTANT) * noise
        return float(
            update(position, rotation, white, self._weights, self._p, self._r, self._v, self._covariance)
        )

    @property
    def state(self) -> MotionState:
        """The fused estimate."""
        error, whole = np.empty(STATE), np.empty((STATE, STATE))
        best = combine(self._weights, self._p, self._r, self._v, self._covariance, error, whole)
        position, rotation, velocity = self._p[best].copy(), self._r[best].copy(), self._v[best].copy()
        _moved(position, rotation, velocity, error)
        whole[:6, :6] += CONSTANT * self._noise
        at_rest = float(self._weights[np.asarray(self._motions.still)].sum())
        return MotionState(position, rotation, velocity, whole, at_rest)
