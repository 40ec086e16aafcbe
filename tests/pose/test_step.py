import numpy as np
import pytest

from tests.helpers import make_camera
from tracker.calibration.deviations import calibration_covariance, rotation_vector_variance
from tracker.geometry import so3
from tracker.pose import solve
from tracker.pose.solution import CAMERA, EXPONENT, MOVING, OWN, SOLUTION, UNKNOWNS

CAMERAS = 3
ROWS = 30


class Problem:
    """A made-up set of linear measurements with all that a step is given, and what comes out of it.

    Where cameras lag behind, the change of velocity is unknown, too.
    """

    def __init__(self, rng, cameras=CAMERAS, *, lagging=False):
        self.size = MOVING if lagging else UNKNOWNS
        self.rows = rng.normal(size=(cameras, ROWS, UNKNOWNS))
        self.residuals = rng.normal(size=(cameras, ROWS))
        self.offsets = rng.normal(size=(cameras, OWN))
        # The share is one of the offsets' variance, not of that of the exponents' deviations.
        self.roots = np.zeros((cameras, OWN, OWN))
        self.roots[:, :6, :6] = 0.7 * rng.normal(size=(cameras, 6, 6)) + np.eye(6)
        self.roots[:, EXPONENT, EXPONENT] = 1.0 / solve.DEVIATION_STD
        self.delays = np.zeros(cameras)
        self.prior = np.diag(rng.uniform(0.5, 2.0, self.size))
        if lagging:
            self.delays[1:] = rng.uniform(0.3, 2.0, cameras - 1)
            root = rng.normal(size=(6, 6))
            self.prior[UNKNOWNS:, UNKNOWNS:] = root @ root.T + np.eye(6)
        self.pull = rng.normal(size=self.size)
        self.solution, self.cameras = np.zeros(1, SOLUTION)[0], np.zeros(cameras, CAMERA)
        self.known = self.solution["known"][: self.size, : self.size]
        self.shared = self.solution["change"][: self.size]
        self.changes = self.cameras["change"]

    @property
    def seen(self):
        """(C, ROWS, n) by what is shared: a picture that is old shows the pose less what it moved since."""
        if self.size == UNKNOWNS:
            return self.rows
        return np.concatenate([self.rows, -self.delays[:, None, None] * self.rows[..., :6]], axis=2)

    def solve(self, share=1.0):
        solution, cameras = self.solution, self.cameras
        solution["size"], solution["prior"], solution["pull"] = self.size, 0.0, 0.0
        solution["prior"][: self.size, : self.size], solution["pull"][: self.size] = self.prior, self.pull
        cameras["information"] = np.einsum("cri,crj->cij", self.rows, self.rows)
        cameras["gradient"] = np.einsum("cri,cr->ci", self.rows, self.residuals)
        cameras["offset"], cameras["delay"] = self.offsets, self.delays
        cameras["weights"] = np.einsum("cki,ckj->cij", self.roots, self.roots)[:, :6, :6]
        doubt = solve.solve(solution, cameras, share)
        solve.finish(solution)
        solve.own_changes(solution, cameras)
        return doubt

    def held(self, c, share):
        """(OWN, OWN) root of the information on what camera c has of its own."""
        return self.roots[c] / np.sqrt([[share]] * 6 + [[1.0]])

    def dense(self, share):
        """Rows and right-hand side of one least squares with the shared unknowns, then the cameras' own."""
        size, root = self.size + OWN * len(self.rows), np.linalg.cholesky(self.prior)
        blocks, sides = [root.T @ np.eye(self.size, size)], [np.linalg.solve(root, self.pull)]
        for c in range(len(self.rows)):
            own = slice(self.size + OWN * c, self.size + OWN * c + OWN)
            seen, held = np.zeros((ROWS, size)), np.zeros((OWN, size))
            seen[:, : self.size], seen[:, own] = self.seen[c], self.rows[c][:, :OWN]
            held[:, own] = self.held(c, share)
            blocks += [seen, held]
            sides += [self.residuals[c], -held[:, own] @ self.offsets[c]]
        return np.concatenate(blocks), np.concatenate(sides)

    def doubt(self, share):
        """Minus twice the log density of the residuals, all unknowns integrated out, and a constant."""
        rows, side = self.dense(share)
        left = side - rows @ np.linalg.lstsq(rows, side, rcond=None)[0]
        held = sum(np.linalg.slogdet(self.held(c, share))[1] for c in range(len(self.rows)))
        return left @ left + np.linalg.slogdet(rows.T @ rows)[1] - 2 * held


@pytest.mark.parametrize(("cameras", "lagging"), [(1, False), (3, False), (2, True), (3, True)])
def test_step_is_that_of_the_dense_least_squares_and_doubt_the_likelihood_of_the_share(rng, cameras, lagging):
    problem, off = Problem(rng, cameras, lagging=lagging), []
    for share in (1.0, 100.0, 0.3, 0.1, 0.01, 0.001):
        rows, side = problem.dense(share)
        expected = np.linalg.lstsq(rows, side, rcond=None)[0]
        off.append(problem.solve(share) - problem.doubt(share))
        np.testing.assert_allclose(problem.shared, expected[: problem.size], atol=1e-9)
        np.testing.assert_allclose(problem.changes.ravel(), expected[problem.size :], atol=1e-9)
        covariance = np.linalg.inv(rows.T @ rows)[: problem.size, : problem.size]
        np.testing.assert_allclose(np.linalg.inv(problem.known), covariance, atol=1e-9)
        np.testing.assert_array_equal(problem.known, problem.known.T)
        assert solve.marginal(problem.solution)
        np.testing.assert_allclose(problem.solution["covariance"], covariance[:6, :6], atol=1e-9)
    np.testing.assert_allclose(off, off[0], rtol=0, atol=1e-8)
    # No covariance is given where there is none.
    problem.known[:] = -np.eye(problem.size)
    assert not solve.marginal(problem.solution)


def test_a_camera_that_sees_nothing_goes_back_to_its_calibration_and_moves_nothing(rng):
    problem = Problem(rng)
    problem.rows[1] = 0
    doubt, shared = problem.solve(0.1), problem.shared.copy()
    np.testing.assert_allclose(problem.changes[1], -problem.offsets[1], atol=1e-9)
    problem.offsets[1] = rng.normal(size=OWN)
    assert problem.solve(0.1) == pytest.approx(doubt, abs=1e-9)
    np.testing.assert_allclose(problem.shared, shared, atol=1e-9)
    # Equations that cannot be solved are refused.
    negative, unknown = Problem(rng), Problem(rng)
    negative.prior[2, 2] = -1e9
    unknown.rows[1, :, :5], unknown.roots[1] = 0, 0
    assert negative.solve() == unknown.solve() == np.inf


def test_camera_offset_is_what_samples_of_the_calibration_show(rng):
    camera, position = make_camera(), np.array([0.05, -0.08, 0.03])
    known = np.linalg.inv(calibration_covariance(camera))
    weights = np.empty((6, 6))
    solve.offset_weights(known, position, weights)
    np.testing.assert_allclose(weights, weights.T, rtol=1e-9, atol=1e-9)
    stated, std = np.linalg.inv(weights), camera.camera_from_world_std
    rotation, translation = camera.camera_from_world[:3, :3], camera.camera_from_world[:3, 3]
    deviations = np.sqrt(rotation_vector_variance(rotation, std[:3, :3]))
    errors = []
    for _ in range(4000):
        turn, shift = so3.exp(rng.normal(size=3) * deviations), rng.normal(size=3) * std[:3, 3]
        # Where a true camera sees the object, and which offset explains that with the stated camera.
        seen = turn @ rotation @ position + translation + shift
        moved = rotation.T @ (seen - translation) - position
        errors.append(np.concatenate([moved, so3.log(rotation.T @ turn @ rotation)]))
    np.testing.assert_allclose(np.cov(np.array(errors).T), stated, rtol=0.1, atol=0.06 * stated.max())


@pytest.mark.parametrize("radius", [0.02, 0.06])
def test_a_covariance_is_never_less_than_the_models_errors(rng, radius):
    root = 1e-3 * rng.normal(size=(6, 6))
    measured = root @ root.T
    stated, nothing, transposed = measured.copy(), np.zeros((6, 6)), np.asfortranarray(measured)
    for covariance in (stated, nothing, transposed):
        solve.add_model_errors(covariance, radius)
    np.testing.assert_array_equal(stated, stated.T)
    errors = np.diag(np.repeat(np.square(np.multiply(solve.MODEL_STD, (radius, 1.0))), 3))
    np.testing.assert_allclose(stated - errors, measured, rtol=1e-6, atol=1e-18)
    np.testing.assert_allclose(nothing, errors, rtol=1e-12)
    # In memory as a solver may leave it.
    np.testing.assert_array_equal(transposed, stated)
