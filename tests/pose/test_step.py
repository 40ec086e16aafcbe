import numpy as np
import pytest

from tracker.pose.solution import CAMERA, EXPONENT, MOVING, OWN, RIM, SOLUTION, UNKNOWNS
from tracker.pose.solve import DEVIATION_STD, finish, marginal, own_changes, solve

CAMERAS = 3
ROWS = 30


class Problem:
    """A made-up set of linear measurements with all that a step is given, and what comes out of it.

    Where cameras lag behind, the change of velocity is unknown, too.
    """

    def __init__(self, rng: np.random.Generator, cameras: int = CAMERAS, *, lagging: bool = False) -> None:
        self.size = MOVING if lagging else UNKNOWNS
        self.rows = rng.normal(size=(cameras, ROWS, UNKNOWNS))
        self.residuals = rng.normal(size=(cameras, ROWS))
        self.offsets = rng.normal(size=(cameras, OWN))
        # The share is one of the offsets' variance, not of that of the exponents' deviations.
        self.roots = np.zeros((cameras, OWN, OWN))
        self.roots[:, :6, :6] = 0.7 * rng.normal(size=(cameras, 6, 6)) + np.eye(6)
        self.roots[:, EXPONENT, EXPONENT] = 1.0 / DEVIATION_STD
        self.delays = np.zeros(cameras)
        self.prior = np.diag(rng.uniform(0.5, 2.0, self.size))
        if lagging:
            self.delays[1:] = rng.uniform(0.3, 2.0, cameras - 1)
            root = rng.normal(size=(6, 6))
            self.prior[UNKNOWNS:, UNKNOWNS:] = root @ root.T + np.eye(6)
        self.pull = rng.normal(size=self.size)
        self.solution, self.cameras = np.zeros(1, SOLUTION)[0], np.zeros(cameras, CAMERA)
        n = self.size
        self.known, self.shared = self.solution["known"][:n, :n], self.solution["change"][:n]
        self.changes = self.cameras["change"]

    @property
    def seen(self) -> np.ndarray:
        """(C, ROWS, n) by what is shared: a picture that is old shows the pose less what it moved since."""
        if self.size == UNKNOWNS:
            return self.rows
        return np.concatenate([self.rows, -self.delays[:, None, None] * self.rows[..., :6]], axis=2)

    def solve(self, share: float = 1.0) -> float:
        solution, cameras = self.solution, self.cameras
        solution["size"], solution["prior"], solution["pull"] = self.size, 0.0, 0.0
        solution["prior"][: self.size, : self.size], solution["pull"][: self.size] = self.prior, self.pull
        cameras["information"] = np.einsum("cri,crj->cij", self.rows, self.rows)
        cameras["gradient"] = np.einsum("cri,cr->ci", self.rows, self.residuals)
        cameras["offset"], cameras["delay"] = self.offsets, self.delays
        cameras["weights"] = np.einsum("cki,ckj->cij", self.roots, self.roots)[:, :6, :6]
        doubt = solve(solution, cameras, share)
        finish(solution)
        own_changes(solution, cameras)
        return doubt

    def held(self, c: int, share: float) -> np.ndarray:
        """(OWN, OWN) root of the information on what camera c has of its own."""
        return self.roots[c] / np.sqrt([[share]] * 6 + [[1.0]])

    def dense(self, share: float) -> tuple[np.ndarray, np.ndarray]:
        """Rows and right-hand side of one least squares with the shared unknowns, then the cameras' own."""
        cameras = len(self.rows)
        size = self.size + OWN * cameras
        root = np.linalg.cholesky(self.prior)
        blocks, sides = [root.T @ np.eye(self.size, size)], [np.linalg.solve(root, self.pull)]
        for c in range(cameras):
            own = slice(self.size + OWN * c, self.size + OWN * c + OWN)
            seen, held = np.zeros((ROWS, size)), np.zeros((OWN, size))
            seen[:, : self.size], seen[:, own] = self.seen[c], self.rows[c][:, :OWN]
            held[:, own] = self.held(c, share)
            blocks += [seen, held]
            sides += [self.residuals[c], -held[:, own] @ self.offsets[c]]
        return np.concatenate(blocks), np.concatenate(sides)

    def doubt(self, share: float) -> float:
        """Minus twice the logarithm of the residuals' density, all unknowns integrated out."""
        cameras = len(self.rows)
        mean, spread = np.zeros((cameras, ROWS)), np.eye(cameras * ROWS)
        stacked = self.seen.reshape(-1, self.size)
        inverse = np.linalg.inv(self.prior)
        spread += stacked @ inverse @ stacked.T
        for c in range(cameras):
            rows, move = self.rows[c][:, :OWN], np.linalg.inv(self.held(c, share))
            mean[c] = self.seen[c] @ inverse @ self.pull - rows @ self.offsets[c]
            own = slice(c * ROWS, (c + 1) * ROWS)
            spread[own, own] += rows @ move @ move.T @ rows.T
        off = (self.residuals - mean).ravel()
        return float(np.linalg.slogdet(spread)[1] + off @ np.linalg.solve(spread, off))


@pytest.mark.parametrize("share", [100.0, 1.0, 0.1, 0.001])
@pytest.mark.parametrize(("cameras", "lagging"), [(1, False), (3, False), (2, True), (3, True)])
def test_step_is_that_of_the_dense_least_squares(rng, share, cameras, lagging):
    problem = Problem(rng, cameras, lagging=lagging)
    rows, side = problem.dense(share)
    expected = np.linalg.lstsq(rows, side, rcond=None)[0]
    assert np.isfinite(problem.solve(share))
    np.testing.assert_allclose(problem.shared, expected[: problem.size], atol=1e-9)
    np.testing.assert_allclose(problem.changes.ravel(), expected[problem.size :], atol=1e-9)
    covariance = np.linalg.inv(rows.T @ rows)[: problem.size, : problem.size]
    np.testing.assert_allclose(np.linalg.inv(problem.known), covariance, atol=1e-9)
    np.testing.assert_array_equal(problem.known, problem.known.T)
    assert marginal(problem.solution)
    np.testing.assert_allclose(problem.solution["covariance"], covariance[:6, :6], atol=1e-9)


def test_a_velocity_that_is_known_exactly_is_none(rng):
    moving = Problem(rng, lagging=True)
    moving.prior[UNKNOWNS:, UNKNOWNS:] = 1e14 * np.eye(6)
    moving.pull[UNKNOWNS:] = 0.0
    moving.solve(0.3)
    still = Problem(rng)
    for key in ("rows", "residuals", "offsets", "roots"):
        setattr(still, key, getattr(moving, key))
    still.prior, still.pull = moving.prior[:UNKNOWNS, :UNKNOWNS].copy(), moving.pull[:UNKNOWNS].copy()
    still.solve(0.3)
    np.testing.assert_allclose(moving.shared[:UNKNOWNS], still.shared, atol=1e-9)
    np.testing.assert_allclose(moving.changes, still.changes, atol=1e-9)
    np.testing.assert_allclose(moving.known[:UNKNOWNS, :UNKNOWNS], still.known, atol=1e-9)


def test_cameras_without_delay_say_nothing_of_the_velocity(rng):
    problem = Problem(rng, lagging=True)
    problem.delays[:] = 0.0
    problem.solve(0.3)
    prior = problem.prior[UNKNOWNS:, UNKNOWNS:]
    np.testing.assert_allclose(problem.known[UNKNOWNS:, UNKNOWNS:], prior, atol=1e-12)
    np.testing.assert_array_equal(problem.known[UNKNOWNS:, :UNKNOWNS], 0)
    np.testing.assert_allclose(
        problem.shared[UNKNOWNS:], np.linalg.solve(prior, problem.pull[UNKNOWNS:]), atol=1e-9
    )


def test_no_covariance_is_given_where_there_is_none(rng):
    problem = Problem(rng)
    problem.solve()
    problem.known[:] = -np.eye(UNKNOWNS)
    assert not marginal(problem.solution)


@pytest.mark.parametrize("lagging", [False, True])
def test_a_second_step_finds_nothing_left_to_do(rng, lagging):
    problem = Problem(rng, lagging=lagging)
    problem.solve(0.3)
    for c in range(CAMERAS):
        problem.residuals[c] -= problem.seen[c] @ problem.shared
        problem.residuals[c] -= problem.rows[c][:, :OWN] @ problem.changes[c]
    problem.offsets = problem.offsets + problem.changes
    problem.pull = problem.pull - problem.prior @ problem.shared
    problem.solve(0.3)
    np.testing.assert_allclose(problem.shared, 0, atol=1e-9)
    np.testing.assert_allclose(problem.changes, 0, atol=1e-9)


@pytest.mark.parametrize("lagging", [False, True])
def test_doubt_is_the_likelihood_of_the_share(rng, lagging):
    problem = Problem(rng, lagging=lagging)
    shares = (1.0, 100.0, 0.3, 0.01, 0.001)
    doubts = np.array([problem.solve(share) for share in shares])
    expected = np.array([problem.doubt(share) for share in shares])
    np.testing.assert_allclose(doubts - doubts[0], expected - expected[0], atol=1e-8)


def test_a_large_share_leaves_the_pose_to_the_prior(rng):
    problem = Problem(rng)
    problem.solve(1e10)
    np.testing.assert_allclose(problem.known[:6, :6], problem.prior[:6, :6], atol=1e-6)
    # What the cameras have in common is still seen: no offset of a camera looks like it.
    assert problem.known[EXPONENT, EXPONENT] > 2 * problem.prior[EXPONENT, EXPONENT]
    assert problem.known[RIM, RIM] > 2 * problem.prior[RIM, RIM]


def test_a_small_share_makes_the_cameras_rigid(rng):
    problem = Problem(rng)
    problem.offsets = np.zeros((CAMERAS, OWN))
    problem.rows[:, :, EXPONENT] = 0.0
    problem.solve(1e-14)
    information, gradient = problem.cameras["information"], problem.cameras["gradient"]
    known = problem.prior + information.sum(axis=0)
    np.testing.assert_allclose(problem.known, known, rtol=1e-6, atol=1e-6)
    shared = np.linalg.solve(known, problem.pull + gradient.sum(axis=0))
    np.testing.assert_allclose(problem.shared, shared, atol=1e-6)
    np.testing.assert_allclose(problem.changes, 0, atol=1e-6)


def test_less_is_known_the_larger_the_share(rng):
    problem = Problem(rng)
    known = []
    for share in (10.0, 1.0, 0.1, 0.01, 0.001):
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
    problem.offsets[1] = rng.normal(size=OWN)
    assert problem.solve(0.1) == pytest.approx(doubt, abs=1e-9)
    np.testing.assert_allclose(problem.shared, shared, atol=1e-9)


def test_equations_that_cannot_be_solved_are_refused(rng):
    problem = Problem(rng)
    problem.prior[2, 2] = -1e9
    assert problem.solve() == np.inf
    problem = Problem(rng)
    problem.rows[1, :, :5], problem.roots[1] = 0, 0
    assert problem.solve() == np.inf
