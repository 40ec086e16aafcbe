from __future__ import annotations

import numpy as np
import pytest

from tests.helpers import numerical_jacobian, random_rotations
from tracker.geometry import so3
from tracker.tracking import motion
from tracker.tracking.motion import STATE, Motions

DT = 0.1

PUSHED = Motions(
    still=np.array([False]), walk=np.array([[3e-4, 6e-3]]), push=np.array([[0.05, 1.0]]), lasting=np.ones(1)
)
"""Constant velocity, disturbed, and nothing else."""


def predicted(p, r, v, covariance, dt, motions=PUSHED):
    """One kind's state and covariance after `motion.predict`."""
    p, r, v, covariance = p[None].copy(), r[None].copy(), v[None].copy(), covariance[None].copy()
    motion.predict(dt, motions, p, r, v, covariance)
    return p[0], r[0], v[0], covariance[0]


NO_PUSH = Motions(np.array([False]), np.zeros((1, 2)), np.zeros((1, 2)), np.ones(1))


@pytest.mark.parametrize(("spin", "within"), [(0.0, 1e-7), (0.5, 0.03), (2.0, 0.11)])
def test_predicted_covariance_is_that_of_the_motions_derivatives(rng, spin, within):
    p, r = rng.normal(size=3), random_rotations(rng, 1)[0]
    v = np.concatenate([rng.normal(size=3), spin * np.array([0.6, 0.0, 0.8])])
    p1, r1, v1, _ = predicted(p, r, v, np.eye(STATE), DT)

    def outcome(error):
        p2, r2, v2, _ = predicted(p + error[:3], so3.exp(error[3:6]) @ r, v + error[6:], np.eye(STATE), DT)
        return np.concatenate([p2 - p1, so3.log(r2 @ r1.T), v2 - v1])

    jacobian = numerical_jacobian(outcome, np.zeros(STATE))
    covariance = np.diag(rng.uniform(0.5, 2.0, STATE))
    stated = predicted(p, r, v, covariance, DT, NO_PUSH)[3]
    # The turn within the step bends the way of an error of the spin, by half that turn; this is left out.
    np.testing.assert_allclose(stated, jacobian @ covariance @ jacobian.T, atol=2 * within * DT)


def test_predicted_covariance_is_that_of_samples(rng):
    count, steps, dt = 20000, 20, 0.1
    start = np.diag(np.repeat(np.square([1e-3, 0.01, 0.02, 0.2]), 3))
    p, r, v = np.zeros(3), np.eye(3), np.array([0.1, 0.0, 0.05, 0.0, 0.5, 0.2])
    p1, r1, v1, stated = predicted(p, r, v, start, dt)
    errors = rng.multivariate_normal(np.zeros(STATE), start, count)
    positions, rotations, velocities = p + errors[:, :3], so3.exp(errors[:, 3:6]) @ r, v + errors[:, 6:]
    h = dt / steps
    walk, push = (np.repeat(getattr(PUSHED, key)[0], 3) for key in ("walk", "push"))
    for _ in range(steps):
        kick = push * np.sqrt(h) * rng.normal(size=(count, 6))
        step = h * (velocities + kick / 2) + walk * np.sqrt(h) * rng.normal(size=(count, 6))
        positions, rotations = positions + step[:, :3], so3.exp(step[:, 3:]) @ rotations
        velocities = velocities + kick
    off = np.concatenate([positions - p1, so3.log(rotations @ r1.T), velocities - v1], axis=1)
    scale = np.sqrt(np.diag(stated))
    np.testing.assert_allclose(np.cov((off / scale).T), stated / np.outer(scale, scale), atol=0.06)
    assert np.abs(off.mean(axis=0) / scale).max() < 0.06


def test_two_half_steps_of_one_kind_are_one_step(rng):
    root = rng.normal(size=(STATE, STATE))
    start = np.zeros(3), np.eye(3), np.array([0.1, 0.2, 0.0, 0.0, 0.0, 0.0]), root @ root.T
    whole = predicted(*start, DT)
    halves = predicted(*predicted(*start, DT / 2), DT / 2)
    for one, other in zip(whole, halves, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-12)


def kinds(rng, count=3):
    """States of so many kinds of motion that differ a little, with their weights and covariances."""
    weights = rng.dirichlet(np.ones(count))
    root = 1e-3 * rng.normal(size=(count, STATE, STATE))
    p, v = 1e-3 * rng.normal(size=(count, 3)), 0.1 * rng.normal(size=(count, 6))
    r = so3.exp(1e-3 * rng.normal(size=(count, 3))) @ random_rotations(rng, 1)
    return weights, p, r, v, root @ np.swapaxes(root, 1, 2)


def moments(weights, p, r, v, covariance):
    """Mean, as an error from the origin and the first rotation, and covariance of all kinds together."""
    means = np.concatenate([p, so3.log(r @ r[0].T), v], axis=1)
    mean = weights @ means
    spread = sum(
        w * (c + np.outer(m - mean, m - mean)) for w, c, m in zip(weights, covariance, means, strict=True)
    )
    return mean, spread


def test_all_kinds_together_have_the_mean_and_the_spread_of_their_mixture(rng):
    weights, p, r, v, covariance = kinds(rng)
    order = np.argsort(-weights)
    weights, p, r, v, covariance = (np.ascontiguousarray(a[order]) for a in (weights, p, r, v, covariance))
    error, whole = np.empty(STATE), np.empty((STATE, STATE))
    assert motion.combine(weights, p, r, v, covariance, error, whole) == 0
    mean, spread = moments(weights, p, r, v, covariance)
    np.testing.assert_allclose(np.concatenate([p[0], np.zeros(3), v[0]]) + error, mean, atol=1e-12)
    np.testing.assert_allclose(whole, spread, atol=1e-12)


def test_kinds_that_change_into_each_other_keep_their_mean_and_spread(rng):
    weights, p, r, v, covariance = kinds(rng)
    first = r[0].copy()
    before = moments(weights, p, r, v, covariance)
    transition = rng.dirichlet(np.ones(3), 3)
    expected = transition.T @ weights
    motion.mix(weights, transition, p, r, v, covariance)
    np.testing.assert_allclose(weights, expected, rtol=1e-12)
    after = moments(weights, p, r, v, covariance)
    # About another first rotation.
    mean = after[0] + np.concatenate([np.zeros(3), so3.log(r[0] @ first.T), np.zeros(6)])
    np.testing.assert_allclose(mean, before[0], atol=2e-6)
    np.testing.assert_allclose(after[1], before[1], atol=1e-6)


def test_kinds_that_keep_to_themselves_are_not_changed_by_mixing(rng):
    states = kinds(rng)
    copies = [array.copy() for array in states]
    motion.mix(states[0], np.eye(3), *states[1:])
    for array, copy in zip(states, copies, strict=True):
        np.testing.assert_allclose(array, copy, rtol=1e-12, atol=1e-15)
