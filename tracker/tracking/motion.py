"""Motion filter: an error-state Kalman filter for the pose over time, with several models of motion.

An object on the platform lies still most of the time, is pushed slowly, or is thrown about. A single filter
cannot smooth the first without lagging in the last. So one filter runs for each kind of motion, weighted by
how well it predicts the measurements (interacting multiple models: Blom and Bar-Shalom 1988).

The state is position p, rotation R and velocity (v, ω) along world axes; its error is
(δp, δθ, δv, δω) with p = p̂ + δp, R = exp(δθ) R̂ [m, rad, m/s, rad/s].
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from tracker.compiled import compiled
from tracker.conventions import Array, FloatArray
from tracker.geometry import so3
from tracker.geometry.lens import apply_update, copy_pose
from tracker.geometry.linear import congruence, factorise, product, substitute

STATE = 12
"""Dimension of the state's error."""

MODE = np.dtype(
    [
        ("weight", np.float64),  # probability that the object moves in this way
        ("position", np.float64, (3,)),  # [m]
        ("rotation", np.float64, (3, 3)),  # world_from_object
        ("velocity", np.float64, (6,)),  # linear [m/s] and angular [rad/s]
        ("covariance", np.float64, (STATE, STATE)),  # of the errors that average out over time
    ]
)
"""State of the filter for one kind of motion."""


class Motions(NamedTuple):
    """Parameters of M kinds of motion."""

    still: Array
    """(M,) whether the velocity is zero."""
    walk: FloatArray
    """(M, 2) random walk of position [m/√s] and rotation [rad/√s], in addition to the velocity."""
    push: FloatArray
    """(M, 2) white-noise acceleration, linear [m/s^1.5] and angular [rad/s^1.5]."""
    lasting: FloatArray
    """(M,) mean duration of each kind of motion [s]."""


MOTIONS = Motions(
    still=np.array([True, False, False]),
    walk=np.array([[5e-6, 1.2e-4], [3e-4, 6e-3], [1e-3, 2e-2]]),
    push=np.array([[0.0, 0.0], [0.05, 1.0], [1.0, 12.0]]),
    lasting=np.array([2.0, 1.0, 0.5]),
)
"""Parameters of the KINDS of motion."""

ACCELERATION = np.array([[0.0, 0.0], [0.6, 8.0], [0.0, 0.0]])
"""(M, 2) standard deviation of an acceleration that lasts for the time of a forecast [m/s², rad/s²]: images
correct it, but a forecast of a carried object has none."""

KINDS = "at rest", "pushed or carried", "thrown or dropped"
"""Names of the kinds of motion."""

DECAY = 0.4
"""Time in which the velocity of an unseen object falls to 1/e [s]: moving objects soon stop."""

START_VELOCITY = np.diag(np.repeat(np.square((0.3, 4.0)), 3))
"""Covariance (6, 6) of a new object's velocity [m/s, rad/s]."""

CONSTANT = 0.8
"""Share of a measurement's covariance that does not average out over time: errors of the calibration and of
the object's model are the same in each image."""

LIKELIEST_SHARE = 0.95
"""A forecast averages the likeliest kinds of motion that together reach this probability."""


@compiled
def moved(position, rotation, velocity, error):  # type: ignore[no-untyped-def]
    """Move a state, in place, by an error (12,)."""
    apply_update(rotation, position, error)
    for i in range(6):
        velocity[i] += error[6 + i]


@compiled
def _spread(modes, weights, to, errors, mean):  # type: ignore[no-untyped-def]
    """Fill errors (M, 12) that turn mode `to` into each of M modes, and their mean (12,) by weights (M,)."""
    mean[:], turned = 0.0, np.empty((3, 3))
    for k in range(len(modes)):
        product(modes[k].rotation, modes[to].rotation.T, turned)
        so3.log_into(turned, errors[k, 3:6])
        for i in range(3):
            errors[k, i] = modes[k].position[i] - modes[to].position[i]
        for i in range(6):
            errors[k, 6 + i] = modes[k].velocity[i] - modes[to].velocity[i]
        for i in range(STATE):
            mean[i] += weights[k] * errors[k, i]


@compiled
def _pool(modes, weights, errors, mean, out):  # type: ignore[no-untyped-def]
    """Set out (12, 12) to the covariance of a mixture of M modes; weights, errors, mean: as in `_spread`."""
    out[:] = 0.0
    for k in range(len(modes)):
        covariance = modes[k].covariance
        for i in range(STATE):
            a = errors[k, i] - mean[i]
            for j in range(STATE):
                out[i, j] += weights[k] * (covariance[i, j] + a * (errors[k, j] - mean[j]))


@compiled
def _mix(dt, motions, old, modes):  # type: ignore[no-untyped-def]
    """Let the kinds of motion `old` change into each other for dt [s]; modes: a copy of them to change.

    See equation (23) of docs/how-it-works.md.
    """
    count = len(modes)
    errors, mean, shares = np.empty((count, STATE)), np.empty(STATE), np.empty(count)
    for j in range(count):
        modes[j].weight = 0.0
        for i in range(count):
            stays = math.exp(-dt / motions.lasting[i])
            shares[i] = old[i].weight * (stays if i == j else (1.0 - stays) / (count - 1))
            modes[j].weight += shares[i]
        for i in range(count):
            shares[i] /= modes[j].weight
        _spread(old, shares, j, errors, mean)
        _pool(old, shares, errors, mean, modes[j].covariance)
        moved(modes[j].position, modes[j].rotation, modes[j].velocity, mean)


@compiled
def predict(dt, motions, old, mixed, modes):  # type: ignore[no-untyped-def]
    """Fill modes with the states and covariances of `old` after dt [s]; mixed: whether to `_mix` them first.

    See equation (22) of docs/how-it-works.md.
    """
    for k in range(len(old)):
        modes[k] = old[k]
    if mixed:
        _mix(dt, motions, old, modes)
    turn, turned = np.empty((3, 3)), np.empty((3, 3))
    step, before = np.eye(STATE), np.empty((STATE, STATE))
    for k in range(len(modes)):
        p, r, v, covariance = modes[k].position, modes[k].rotation, modes[k].velocity, modes[k].covariance
        if motions.still[k]:
            for i in range(6, STATE):
                v[i - 6] = 0.0
                for j in range(STATE):
                    covariance[i, j] = covariance[j, i] = 0.0
        else:
            so3.exp_into(dt * v[3:], turn)
            product(turn, r, turned)
            for i in range(3):
                p[i] += dt * v[i]
                for j in range(3):
                    r[i, j] = turned[i, j]
                    step[3 + i, 3 + j] = turn[i, j]
            for i in range(6):
                step[i, 6 + i] = dt
            for i in range(STATE):
                for j in range(STATE):
                    before[i, j], covariance[i, j] = covariance[i, j], 0.0
            congruence(step, before, covariance)
        for i in range(6):
            kind = 0 if i < 3 else 1
            walk, push = motions.walk[k, kind] ** 2, motions.push[k, kind] ** 2
            covariance[i, i] += walk * dt + push * dt**3 / 3.0
            covariance[i, 6 + i] += push * dt**2 / 2.0
            covariance[6 + i, i] += push * dt**2 / 2.0
            covariance[6 + i, 6 + i] += push * dt


@compiled
def _correct(innovation, noise, mode):  # type: ignore[no-untyped-def]
    """Kalman update of one mode, in place; return the innovation's log likelihood up to a constant."""
    covariance = mode.covariance
    spread, lower, gain = np.empty((6, 6)), np.zeros((6, 6)), np.empty((STATE, 6))
    keep, before = np.zeros((STATE, STATE)), np.empty((STATE, STATE))
    error, pull = np.empty(STATE), np.empty(6)
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
        for j in range(STATE):
            before[i, j], covariance[i, j] = covariance[i, j], 0.0
        substitute(lower, before[i, :6], gain[i])
        error[i], keep[i, i] = 0.0, 1.0
        for j in range(6):
            error[i] += gain[i, j] * innovation[j]
            keep[i, j] -= gain[i, j]
    moved(mode.position, mode.rotation, mode.velocity, error)
    # The Joseph form keeps the covariance symmetric and positive definite.
    congruence(keep, before, covariance)
    congruence(gain, noise, covariance)
    return likelihood


@compiled
def update(position, rotation, noise, old, modes):  # type: ignore[no-untyped-def]
    """Fill modes with those of `old` after a measurement of covariance `noise` (6, 6).

    See equation (24) of docs/how-it-works.md.
    """
    count, best = len(modes), -np.inf
    likelihood, innovation, turned = np.empty(count), np.empty(6), np.empty((3, 3))
    for k in range(count):
        modes[k] = old[k]
        for i in range(3):
            innovation[i] = position[i] - modes[k].position[i]
        product(rotation, modes[k].rotation.T, turned)
        so3.log_into(turned, innovation[3:])
        likelihood[k] = _correct(innovation, noise, modes[k])
        best = max(best, likelihood[k])
    total, rest = 0.0, 0.0
    for k in range(count):
        modes[k].weight *= math.exp(likelihood[k] - best)
        total += modes[k].weight
    for k in range(count):
        # A minimum weight lets an unlikely kind come back.
        modes[k].weight = max(modes[k].weight / total, 1e-6)
        rest += modes[k].weight
    for k in range(count):
        modes[k].weight /= rest


@compiled
def combine(motions, modes, noise, position, rotation, velocity, covariance):  # type: ignore[no-untyped-def]
    """Fill state and covariance (12, 12) of all modes together; return the probability of rest.

    See equation (25) of docs/how-it-works.md.
    noise: (6, 6) covariance of the last measurement.
    """
    best, at_rest = 0, 0.0
    for k in range(len(modes)):
        at_rest += modes[k].weight if motions.still[k] else 0.0
        if modes[k].weight > modes[best].weight:
            best = k
    weights, errors, mean = np.empty(len(modes)), np.empty((len(modes), STATE)), np.empty(STATE)
    for k in range(len(modes)):
        weights[k] = modes[k].weight
    _spread(modes, weights, best, errors, mean)
    _pool(modes, weights, errors, mean, covariance)
    copy_pose(modes[best].rotation, modes[best].position, rotation, position)
    for i in range(6):
        velocity[i] = modes[best].velocity[i]
        for j in range(6):
            covariance[i, j] += CONSTANT * noise[i, j]
    moved(position, rotation, velocity, mean)
    return at_rest


class MotionState(NamedTuple):
    """Pose and velocity of the object, with their covariance."""

    position: FloatArray
    """(3,) [m]."""
    rotation: FloatArray
    """(3, 3) world_from_object."""
    velocity: FloatArray
    """(6,) linear [m/s] and angular [rad/s], along world axes."""
    covariance: FloatArray
    """(12, 12) of (δp, δθ, δv, δω)."""
    at_rest: float
    """Probability that the object is at rest."""


class MotionFilter(NamedTuple):
    """The filter's state for each kind of motion. Immutable: every method returns a new one."""

    modes: Array
    """(M,) of MODE, one for each of KINDS."""
    noise: FloatArray
    """(6, 6) covariance of the last measurement."""

    @classmethod
    def start(cls, position: FloatArray, rotation: FloatArray, noise: FloatArray) -> MotionFilter:
        """Return a filter started from a first measurement with its covariance (6, 6)."""
        modes = np.zeros(len(KINDS), MODE)
        modes["weight"] = 1.0 / len(KINDS)
        modes["position"], modes["rotation"] = position, rotation
        modes["covariance"][:, :6, :6] = (1 - CONSTANT) * noise
        modes["covariance"][~MOTIONS.still, 6:, 6:] = START_VELOCITY
        return cls(modes, noise)

    def predicted(self, dt: float) -> MotionFilter:
        """Return the filter predicted over dt [s]."""
        return self._after(dt, self.modes)

    def _after(self, dt: float, old: Array, motions: Motions = MOTIONS, mixed: bool = True) -> MotionFilter:
        modes = np.empty_like(old)
        predict(dt, motions, old, mixed, modes)
        return MotionFilter(modes, self.noise)

    def unseen(self, dt: float) -> MotionFilter:
        """Return the filter after dt > 0 [s] in which the object was not seen, and slowed down."""
        slowed, passed = self.modes.copy(), dt / DECAY
        mean = -math.expm1(-passed) / passed
        slowed["velocity"] *= mean
        found = self._after(dt, slowed)
        found.modes["velocity"] *= math.exp(-passed) / mean
        return found

    def updated(
        self, position: FloatArray, rotation: FloatArray, noise: FloatArray, *, others: bool = False
    ) -> MotionFilter:
        """Return the filter updated with a measurement and its covariance (6, 6).

        others: whether the last one had large constant errors that this one does not share, as with a single
            camera: their difference is then not motion.
        """
        old, modes = self.modes, np.empty_like(self.modes)
        if others:
            old = old.copy()
            old["covariance"][:, :6, :6] += CONSTANT * self.noise
        update(position, rotation, (1 - CONSTANT) * noise, old, modes)
        return MotionFilter(modes, noise)

    def forecast(self, dt: float, *, changing: bool = False) -> MotionFilter:
        """Return the filter after dt [s] if each kind of motion continues.

        changing: whether the kind may change, as between images; used for confidences. In poses, rare changes
            would hide what is nearly certain.
        """
        # A displacement of a dt²/2 has the variance that white noise of this strength causes.
        push = np.sqrt(MOTIONS.push**2 + 0.75 * dt * ACCELERATION**2)
        return self._after(dt, self.modes, MOTIONS._replace(push=push), mixed=changing)

    def kinds(self) -> list[tuple[int, float, MotionState]]:
        """Return (kind, weight, state) of each kind of motion, the likeliest first."""
        order = np.argsort(-self.modes["weight"], kind="stable").tolist()
        alone = np.eye(len(order))
        return [(k, float(self.modes["weight"][k]), self._weighted(alone[k]).state) for k in order]

    def likeliest(self) -> MotionState:
        """Return the fused state of the likeliest kinds."""
        weights = self.modes["weight"]
        order = np.argsort(-weights, kind="stable")
        count = int(np.searchsorted(np.cumsum(weights[order]), LIKELIEST_SHARE)) + 1
        likely = np.zeros_like(weights)
        likely[order[:count]] = weights[order[:count]]
        return self._weighted(likely / likely.sum()).state

    def _weighted(self, weights: FloatArray) -> MotionFilter:
        modes = self.modes.copy()
        modes["weight"] = weights
        return MotionFilter(modes, self.noise)

    def parts(self, state: MotionState) -> Iterator[tuple[float, FloatArray]]:
        """Yield weight and covariance (6, 6) of each kind's pose, about that of the fused state."""
        for mode in self.modes:
            turned = so3.log(mode["rotation"] @ state.rotation.T)
            off = np.concatenate([mode["position"] - state.position, turned])
            spread = mode["covariance"][:6, :6] + np.outer(off, off) + CONSTANT * self.noise
            yield float(mode["weight"]), spread

    @property
    def state(self) -> MotionState:
        """The fused estimate."""
        position, rotation, velocity = np.empty(3), np.empty((3, 3)), np.empty(6)
        covariance = np.empty((STATE, STATE))
        at_rest = combine(MOTIONS, self.modes, self.noise, position, rotation, velocity, covariance)
        return MotionState(position, rotation, velocity, covariance, at_rest)
