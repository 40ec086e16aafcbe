"""The filter as a value: prediction and measurement each make a new one."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tracker.conventions import FloatArray
from tracker.tracking.motion import (
    CONSTANT,
    DECAY,
    MOTIONS,
    START_STD,
    STATE,
    Motions,
    combine,
    mix,
    moved,
    predict,
    update,
)


def unknown_velocity() -> tuple[FloatArray, FloatArray]:
    """Velocity (6,) [m/s, rad/s] of an object that was never seen before, and its covariance (6, 6)."""
    return np.zeros(6), np.diag(np.repeat(np.square(START_STD), 3))


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


LIKELY = 0.95
"""Probability that the kinds of motion together have which a forecast allows for: the likeliest of them."""


class MotionFilter(NamedTuple):
    """What is known of a pose over time, for each of M kinds of motion; nothing changes it."""

    motions: Motions
    weights: FloatArray
    """(M,) probability of each kind."""
    positions: FloatArray
    """(M, 3) [m]."""
    rotations: FloatArray
    """(M, 3, 3) world_from_object."""
    velocities: FloatArray
    """(M, 6) [m/s, rad/s]."""
    covariances: FloatArray
    """(M, 12, 12) of what averages away over time."""
    noise: FloatArray
    """(6, 6) covariance of the last measurement."""

    @classmethod
    def start(
        cls, position: FloatArray, rotation: FloatArray, noise: FloatArray, motions: Motions = MOTIONS
    ) -> MotionFilter:
        """What a first measurement with its covariance (6, 6) tells."""
        kinds = len(motions.lasting)
        covariances = np.zeros((kinds, STATE, STATE))
        covariances[:, :6, :6] = (1 - CONSTANT) * noise
        covariances[~np.asarray(motions.still), 6:, 6:] = unknown_velocity()[1]
        return cls(
            motions,
            np.full(kinds, 1.0 / kinds),
            np.tile(np.asarray(position, dtype=np.float64), (kinds, 1)),
            np.tile(np.asarray(rotation, dtype=np.float64), (kinds, 1, 1)),
            np.zeros((kinds, 6)),
            covariances,
            noise,
        )

    def predicted(self, dt: float) -> MotionFilter:
        """The same, moved on by dt [s]."""
        new = self._copy()
        mix(new.weights, self._transition(dt), new.positions, new.rotations, new.velocities, new.covariances)
        predict(dt, self.motions, new.positions, new.rotations, new.velocities, new.covariances)
        return new

    def _copy(self) -> MotionFilter:
        return self._replace(
            weights=self.weights.copy(),
            positions=self.positions.copy(),
            rotations=self.rotations.copy(),
            velocities=self.velocities.copy(),
            covariances=self.covariances.copy(),
        )

    def _transition(self, dt: float) -> FloatArray:
        """(M, M) probabilities that a kind of motion, by rows, has become another after dt [s]."""
        kinds = len(self.weights)
        stay = np.exp(-dt / self.motions.lasting)
        others = ((1 - stay) / (kinds - 1))[:, None] * (1 - np.eye(kinds))
        return np.asarray(np.diag(stay) + others)

    def slowed(self, dt: float) -> MotionFilter:
        """The same with a velocity that has faded for dt [s], as of an object that is not seen."""
        return self._replace(velocities=self.velocities * math.exp(-dt / DECAY))

    def updated(self, position: FloatArray, rotation: FloatArray, noise: FloatArray) -> MotionFilter:
        """The same with a measurement and its covariance (6, 6) taken in."""
        new = self._copy()._replace(noise=noise)
        white = (1 - CONSTANT) * noise
        update(
            position, rotation, white, new.weights, new.positions, new.rotations, new.velocities,
            new.covariances,
        )  # fmt: skip
        return new

    def forecast(self, dt: float) -> tuple[MotionState, list[tuple[int, float, MotionState]]]:
        """Where the object is after dt [s] if its motion goes on; and if it is of each kind (number, weight).

        Of the fused state the covariance is that of the likely kinds. That a motion may turn into another one
        counts between pictures, not here: what seldom happens would hide what is nearly certain.
        """
        new = self._copy()
        predict(dt, self.motions, new.positions, new.rotations, new.velocities, new.covariances)
        order = np.argsort(-self.weights, kind="stable")
        count = int(np.searchsorted(np.cumsum(self.weights[order]), LIKELY)) + 1
        likely = np.zeros_like(self.weights)
        likely[order[:count]] = self.weights[order[:count]]
        kinds = [
            (k, float(self.weights[k]), new._replace(weights=np.eye(len(order))[k]).state)
            for k in order.tolist()
        ]
        return new._replace(weights=likely / likely.sum()).state, kinds

    @property
    def state(self) -> MotionState:
        """The fused estimate."""
        error, whole = np.empty(STATE), np.empty((STATE, STATE))
        best = combine(
            self.weights, self.positions, self.rotations, self.velocities, self.covariances, error, whole
        )
        position, rotation = self.positions[best].copy(), self.rotations[best].copy()
        velocity = self.velocities[best].copy()
        moved(position, rotation, velocity, error)
        whole[:6, :6] += CONSTANT * self.noise
        at_rest = float(self.weights[np.asarray(self.motions.still)].sum())
        return MotionState(position, rotation, velocity, whole, at_rest)
