from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.helpers import numerical_jacobian, random_rotations
from tracker.geometry import so3
from tracker.pose import motion
from tracker.tracking.motion import STATE, Motions

DT = 0.1

PUSHED = Motions(
    still=np.array([False]), walk=np.array([[3e-4, 6e-3]]), push=np.array([[0.05, 1.0]]), lasting=np.ones(1)
)
"""Constant velocity, disturbed, and nothing else."""


def exp(vector):
    out = np.empty((3, 3))
    motion._exp(np.asarray(vector, dtype=np.float64), out)
    return out


def log(rotation):
    out = np.empty(3)
    motion._log(np.ascontiguousarray(rotation), out)
    return out


@given(st.floats(0, 3.14), st.integers(0, 2**31))
def test_exp_and_log_are_inverse_and_those_of_so3(angle, seed):
    axis = np.random.default_rng(seed).normal(size=3)
    vector = angle * axis / np.linalg.norm(axis)
    np.testing.assert_allclose(exp(vector), so3.exp(vector), atol=1e-14)
    np.testing.assert_allclose(log(so3.exp(vector)), vector, atol=1e-11)
    np.testing.assert_allclose(log(exp(vector)), vector, atol=1e-11)


@pytest.mark.parametrize("angle", [0.0, 1e-300, 1e-12, 1e-7, 0.999e-6, 1.001e-6, 0.999e-4, 1.001e-4, 1e-3])
def test_exp_and_log_keep_the_digits_of_small_turns(angle, rng):
    axis = rng.normal(size=3)
    vector = angle * axis / np.linalg.norm(axis)
    np.testing.assert_allclose(exp(vector), so3.exp(vector), rtol=1e-15, atol=1e-16)
    np.testing.assert_allclose(log(exp(vector)), vector, rtol=1e-11, atol=1e-18)


@pytest.mark.parametrize("below", [1e-1, 1e-3, 1e-5])
def test_log_is_good_up_to_nearly_a_half_turn(below, rng):
    for axis in [*np.eye(3), *rng.normal(size=(20, 3))]:
        vector = (np.pi - below) * axis / np.linalg.norm(axis)
        np.testing.assert_allclose(log(so3.exp(vector)), vector, atol=1e-9)


@pytest.mark.parametrize("below", [0.0, 1e-8, 1e-7])
def test_log_of_a_half_turn_is_not_small(below, rng):
    for axis in [*np.eye(3), *rng.normal(size=(20, 3))]:
        vector = (np.pi - below) * axis / np.linalg.norm(axis)
        assert np.linalg.norm(log(so3.exp(vector))) == pytest.approx(np.pi, abs=1e-5)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-3, 1.0, 2.0, np.pi - 1e-9, np.pi])
def test_compiled_quaternion_is_that_of_so3(angle, rng):
    for axis in [*np.eye(3), *-np.eye(3), *rng.normal(size=(20, 3))]:
        rotation = so3.exp(angle * axis / np.linalg.norm(axis))
        compiled, expected = motion.quaternion(rotation), so3.quaternion_from_matrix(rotation)
        assert compiled[3] >= 0
        # The sign of a half turn hangs on rounding.
        expected = expected * (np.sign(compiled @ expected) if expected[3] < 1e-12 else 1.0)
        np.testing.assert_allclose(compiled, expected, atol=1e-15)


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
