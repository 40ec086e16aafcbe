import numpy as np
import pytest

from tests.helpers import numerical_jacobian, random_rotations
from tracker.geometry import so3
from tracker.tracking import motion
from tracker.tracking.motion import CONSTANT, MODE, MOTIONS, STATE, Motions

DT = 0.1

PUSHED = Motions(
    still=np.array([False]), walk=np.array([[3e-4, 6e-3]]), push=np.array([[0.05, 1.0]]), lasting=np.ones(1)
)
"""Constant velocity, disturbed, and nothing else."""


def predicted(p, r, v, covariance, dt, motions=PUSHED):
    """One mode's state and covariance after `motion.predict`."""
    modes = np.array([(1.0, p, r, v, covariance)], MODE)
    motion.predict(dt, motions, modes, False)
    return modes[0].tolist()[1:]


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


def drawn_modes(rng, count=3):
    """Modes that differ a little, the likeliest first."""
    modes = np.zeros(count, MODE)
    modes["weight"] = np.sort(rng.dirichlet(np.ones(count)))[::-1]
    root = 1e-3 * rng.normal(size=(count, STATE, STATE))
    modes["covariance"] = root @ np.swapaxes(root, 1, 2)
    modes["position"], modes["velocity"] = (
        1e-3 * rng.normal(size=(count, 3)),
        0.1 * rng.normal(size=(count, 6)),
    )
    modes["rotation"] = so3.exp(1e-3 * rng.normal(size=(count, 3))) @ random_rotations(rng, 1)
    return modes


def moments(modes):
    """Mean, as an error from the origin and the first rotation, and covariance of all modes together."""
    turns = so3.log(modes["rotation"] @ modes["rotation"][0].T)
    means = np.concatenate([modes["position"], turns, modes["velocity"]], axis=1)
    mean, off = modes["weight"] @ means, means - modes["weight"] @ means
    spread = modes["covariance"] + off[:, :, None] * off[:, None, :]
    return mean, np.einsum("n,nij->ij", modes["weight"], spread)


def test_all_kinds_together_have_the_mean_and_the_spread_of_their_mixture(rng):
    modes = drawn_modes(rng)
    found, whole = np.empty(1, MODE), np.empty((STATE, STATE))
    noise = np.diag(rng.uniform(0.5, 2.0, 6))
    assert motion.combine(MOTIONS, modes, noise, found, whole) == modes["weight"][0]
    whole[:6, :6] -= CONSTANT * noise
    mean, spread = moments(modes)
    np.testing.assert_allclose(found["position"][0], mean[:3], atol=1e-12)
    np.testing.assert_allclose(so3.log(found["rotation"][0] @ modes["rotation"][0].T), mean[3:6], atol=1e-12)
    np.testing.assert_allclose(found["velocity"][0], mean[6:], atol=1e-12)
    np.testing.assert_allclose(whole, spread, atol=1e-12)


def mixed(modes, lasting, dt=1e-9):
    """Let modes change into each other in so short a time that none moves, in place."""
    nothing = np.zeros((3, 2))
    motion.predict(dt, Motions(np.zeros(3, bool), nothing, nothing, lasting), modes, True)


def test_kinds_that_change_into_each_other_keep_their_mean_and_spread(rng):
    modes = drawn_modes(rng)
    first, before = modes["rotation"][0].copy(), moments(modes)
    lasting = 1e-9 * rng.uniform(0.5, 2.0, 3)
    stay = np.exp(-1e-9 / lasting)
    transition = np.where(np.eye(3), stay, np.repeat((1 - stay)[:, None] / 2, 3, axis=1))
    expected = transition.T @ modes["weight"]
    mixed(modes, lasting)
    np.testing.assert_allclose(modes["weight"], expected, rtol=1e-12)
    after = moments(modes)
    # About another first rotation.
    mean = after[0] + np.concatenate([np.zeros(3), so3.log(modes["rotation"][0] @ first.T), np.zeros(6)])
    np.testing.assert_allclose(mean, before[0], atol=2e-6)
    np.testing.assert_allclose(after[1], before[1], atol=1e-6)


def test_kinds_that_keep_to_themselves_are_not_changed_by_mixing(rng):
    modes = drawn_modes(rng)
    before = modes.copy()
    mixed(modes, np.full(3, np.inf))
    for name in MODE.names:
        np.testing.assert_allclose(modes[name], before[name], rtol=1e-12, atol=1e-9)
