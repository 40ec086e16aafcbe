from __future__ import annotations

import numpy as np
import pytest

from tracker.pose.solve.step import (
    EXPONENT,
    GROWTH,
    SHARES,
    SHARES_PRIOR,
    UNKNOWNS,
    calibration_share,
    solve_step,
)

CAMERAS = 3
ROWS = 30


class Problem:
    """A made-up set of linear measurements with all that a step is given, and what comes out of it."""

    def __init__(self, rng: np.random.Generator, cameras: int = CAMERAS) -> None:
        self.rows = rng.normal(size=(cameras, ROWS, UNKNOWNS))
        self.residuals = rng.normal(size=(cameras, ROWS))
        self.offsets = rng.normal(size=(cameras, 6))
        self.roots = 0.7 * rng.normal(size=(cameras, 6, 6)) + np.eye(6)
        self.prior = np.diag(rng.uniform(0.5, 2.0, UNKNOWNS))
        self.pull = rng.normal(size=UNKNOWNS)
        self.known = np.zeros((UNKNOWNS, UNKNOWNS))
        self.shared, self.changes = np.zeros(UNKNOWNS), np.zeros((cameras, 6))

    @property
    def arguments(self) -> tuple[np.ndarray, ...]:
        return (
            np.einsum("cri,crj->cij", self.rows, self.rows),
            np.einsum("cri,cr->ci", self.rows, self.residuals),
            self.offsets,
            np.einsum("cki,ckj->cij", self.roots, self.roots),
        )

    def solve(self, share: float = 1.0) -> float:
        outputs = (self.known, self.shared, self.changes)
        return solve_step(self.arguments, share, self.prior, self.pull, *outputs)

    def share(self) -> float:
        outputs = (self.known, self.shared, self.changes)
        return calibration_share(self.arguments, self.prior, self.pull, *outputs)

    def dense(self, share: float) -> tuple[np.ndarray, np.ndarray]:
        """Rows and right-hand side of one least squares with the shared unknowns, then the offsets'."""
        cameras = len(self.rows)
        size = UNKNOWNS + 6 * cameras
        blocks, sides = [np.eye(UNKNOWNS, size) * np.sqrt(np.diag(self.prior))[:, None]], []
        sides.append(self.pull / np.sqrt(np.diag(self.prior)))
        for c in range(cameras):
            own = slice(UNKNOWNS + 6 * c, UNKNOWNS + 6 * c + 6)
            seen, held = np.zeros((ROWS, size)), np.zeros((6, size))
            seen[:, :UNKNOWNS], seen[:, own] = self.rows[c], self.rows[c][:, :6]
            held[:, own] = self.roots[c] / np.sqrt(share)
            blocks += [seen, held]
            sides += [self.residuals[c], -held[:, own] @ self.offsets[c]]
        return np.concatenate(blocks), np.concatenate(sides)

    def doubt(self, share: float) -> float:
        """Minus twice the logarithm of the residuals' density, all unknowns integrated out."""
        cameras = len(self.rows)
        mean, spread = np.zeros((cameras, ROWS)), np.eye(cameras * ROWS)
        stacked = self.rows.reshape(-1, UNKNOWNS)
        inverse = np.linalg.inv(self.prior)
        spread += stacked @ inverse @ stacked.T
        for c in range(cameras):
            mean[c] = self.rows[c] @ inverse @ self.pull - self.rows[c][:, :6] @ self.offsets[c]
            own, move = slice(c * ROWS, (c + 1) * ROWS), np.linalg.inv(self.roots[c])
            spread[own, own] += share * self.rows[c][:, :6] @ move @ move.T @ self.rows[c][:, :6].T
        off = (self.residuals - mean).ravel()
        return float(np.linalg.slogdet(spread)[1] + off @ np.linalg.solve(spread, off))


@pytest.mark.parametrize("share", [1.0, 0.1, 0.001])
@pytest.mark.parametrize("cameras", [1, 3])
def test_step_is_that_of_the_dense_least_squares(rng, share, cameras):
    problem = Problem(rng, cameras)
    rows, side = problem.dense(share)
    expected = np.linalg.lstsq(rows, side, rcond=None)[0]
    assert np.isfinite(problem.solve(share))
    np.testing.assert_allclose(problem.shared, expected[:UNKNOWNS], atol=1e-9)
    np.testing.assert_allclose(problem.changes.ravel(), expected[UNKNOWNS:], atol=1e-9)
    covariance = np.linalg.inv(rows.T @ rows)[:UNKNOWNS, :UNKNOWNS]
    np.testing.assert_allclose(np.linalg.inv(problem.known), covariance, atol=1e-9)


def test_a_second_step_finds_nothing_left_to_do(rng):
    problem = Problem(rng)
    problem.solve(0.3)
    for c in range(CAMERAS):
        moved = problem.shared.copy()
        moved[:6] += problem.changes[c]
        problem.residuals[c] -= problem.rows[c] @ moved
    problem.offsets = problem.offsets + problem.changes
    problem.pull = problem.pull - problem.prior @ problem.shared
    problem.solve(0.3)
    np.testing.assert_allclose(problem.shared, 0, atol=1e-9)
    np.testing.assert_allclose(problem.changes, 0, atol=1e-9)


def test_doubt_is_the_likelihood_of_the_share(rng):
    problem = Problem(rng)
    shares = (1.0, 0.3, 0.01, 0.001)
    doubts = np.array([problem.solve(share) for share in shares])
    expected = np.array([problem.doubt(share) for share in shares])
    np.testing.assert_allclose(doubts - doubts[0], expected - expected[0], atol=1e-8)


def test_a_large_share_leaves_the_pose_to_the_prior(rng):
    problem = Problem(rng)
    problem.solve(1e10)
    np.testing.assert_allclose(problem.known[:6, :6], problem.prior[:6, :6], atol=1e-6)
    # What the cameras have in common is still seen: no offset of a camera looks like it.
    assert problem.known[EXPONENT, EXPONENT] > 2 * problem.prior[EXPONENT, EXPONENT]
    assert problem.known[GROWTH, GROWTH] > 2 * problem.prior[GROWTH, GROWTH]


def test_a_small_share_makes_the_cameras_rigid(rng):
    problem = Problem(rng)
    problem.offsets = np.zeros((CAMERAS, 6))
    problem.solve(1e-14)
    information, gradient = problem.arguments[:2]
    known = problem.prior + information.sum(axis=0)
    np.testing.assert_allclose(problem.known, known, rtol=1e-6, atol=1e-6)
    shared = np.linalg.solve(known, problem.pull + gradient.sum(axis=0))
    np.testing.assert_allclose(problem.shared, shared, atol=1e-6)
    np.testing.assert_allclose(problem.changes, 0, atol=1e-6)


def test_less_is_known_the_larger_the_share(rng):
    problem = Problem(rng)
    known = []
    for share in SHARES:
        problem.solve(share)
        known.append(problem.known.copy())
    assert (np.linalg.eigvalsh(np.diff(known, axis=0)) > -1e-9).all()


def test_covariance_grows_when_a_camera_is_covered(rng):
    problem = Problem(rng)
    problem.solve()
    full = np.linalg.inv(problem.known)
    problem.rows[1] = 0
    problem.solve()
    assert (np.linalg.eigvalsh(np.linalg.inv(problem.known) - full) > 0).all()


def test_a_camera_that_sees_nothing_goes_back_to_its_calibration_and_moves_nothing(rng):
    problem = Problem(rng)
    problem.rows[1] = 0
    doubt, shared = problem.solve(0.1), problem.shared.copy()
    np.testing.assert_allclose(problem.changes[1], -problem.offsets[1], atol=1e-9)
    problem.offsets[1] = rng.normal(size=6)
    assert problem.solve(0.1) == pytest.approx(doubt, abs=1e-9)
    np.testing.assert_allclose(problem.shared, shared, atol=1e-9)


def test_equations_that_cannot_be_solved_are_refused(rng):
    problem = Problem(rng)
    problem.prior[2, 2] = -1e9
    assert problem.solve() == np.inf
    problem = Problem(rng)
    problem.rows[:], problem.roots[1] = 0, 0
    assert problem.solve() == np.inf
    assert problem.share() == 1.0


def problem_with_share(rng: np.random.Generator, share: float, cameras: int = CAMERAS) -> Problem:
    """Measurements as they come about: unknowns from their prior, offsets of that share, unit noise."""
    problem = Problem(rng, cameras)
    problem.rows *= 3.0
    problem.offsets, problem.pull = np.zeros((cameras, 6)), np.zeros(UNKNOWNS)
    # A pose that is hardly known before, next to cameras that are known well.
    problem.prior[:6] *= 1e-2
    unknown = rng.normal(size=UNKNOWNS) / np.sqrt(np.diag(problem.prior))
    for c in range(cameras):
        moved = unknown.copy()
        moved[:6] += np.sqrt(share) * np.linalg.solve(problem.roots[c], rng.normal(size=6))
        problem.residuals[c] = problem.rows[c] @ moved + rng.normal(size=ROWS)
    return problem


def test_share_is_high_where_cameras_disagree_and_low_where_they_agree(rng):
    disagreeing = [problem_with_share(rng, 1.0).share() for _ in range(100)]
    agreeing = [problem_with_share(rng, 0.001).share() for _ in range(100)]
    assert np.median(disagreeing) > 0.8
    assert np.median(agreeing) < 0.02
    assert np.quantile(agreeing, 0.95) < np.quantile(disagreeing, 0.05)


def test_share_is_unbiased_over_its_prior(rng):
    # The mean of a posterior: no function of it tells on average which way the truth deviates.
    truth = rng.choice(SHARES, p=SHARES_PRIOR, size=3000)
    mean = np.array([problem_with_share(rng, share).share() for share in truth])
    assert (mean >= SHARES.min()).all()
    assert (mean <= SHARES.max()).all()
    for test in (np.ones_like(mean), mean, mean**2, np.log(mean)):
        off = (truth - mean) * test
        assert abs(off.mean()) < 3 * off.std() / np.sqrt(len(off))


def test_one_camera_cannot_tell_its_share(rng):
    # Nothing to compare with; only the weak prior of the pose speaks.
    means = [problem_with_share(rng, 0.01, cameras=1).share() for _ in range(50)]
    assert np.median(means) == pytest.approx(SHARES @ SHARES_PRIOR, abs=0.1)


def test_probabilities_of_the_shares_sum_to_one():
    assert SHARES_PRIOR.sum() == pytest.approx(1)
    assert len(SHARES) == len(SHARES_PRIOR)
    assert (np.diff(SHARES) < 0).all()
