import numpy as np
import pytest

from tracker.pose.sizes import (
    ALIKE,
    FEET,
    FEET_PRIOR,
    MOVING_SHARE,
    SHARES,
    SHARES_PRIOR,
    WEAR,
    WEAR_PRIOR,
    WORN,
    sizes,
)
from tracker.pose.solution import CAMERA, EDGE, EXPONENT, KNOWN, OWN, PULL, RIM, ROW, SOLUTION, UNKNOWNS
from tracker.pose.solve import DEVIATION_STD, with_edges

CAMERAS, EDGES, PIECES = 3, 9, 6
FOCAL = 500.0  # offset of an edge per metre by which its colours end too early [px/m]
COUNTED = WEAR + ALIKE[0] * (1 - ALIKE[1] / CAMERAS) * WORN
STANDING = np.array([1.0, 1.0] + 10 * [0.0])


class Problem:
    """Measurements as they come about: unknowns from their prior, offsets of cameras and edges, noise."""

    NOISE = 0.05
    """[px]"""

    def __init__(
        self,
        rng: np.random.Generator,
        share: float,
        wear: float = 0.0,
        cameras: int = CAMERAS,
        foot: float | None = None,
    ) -> None:
        self.count, self.feet = cameras, np.zeros(12) if foot is None else STANDING
        self.rows = 3.0 * self.NOISE * rng.normal(size=(cameras, EDGES * PIECES, UNKNOWNS))
        self.roots = np.zeros((cameras, OWN, OWN))
        self.roots[:, :6, :6] = 0.7 * rng.normal(size=(cameras, 6, 6)) + np.eye(6)
        self.roots[:, EXPONENT, EXPONENT] = 1.0 / DEVIATION_STD
        self.prior = np.diag(rng.uniform(0.5, 2.0, UNKNOWNS))
        self.prior[:6] *= 1e-2  # hardly known before, next to cameras that are known well
        unknown = rng.normal(size=UNKNOWNS) / np.sqrt(np.diag(self.prior))
        self.residuals = np.zeros((cameras, EDGES * PIECES))
        for c in range(cameras):
            moved = unknown.copy()
            held = self.roots[c] / np.sqrt([[share]] * 6 + [[1.0]])
            moved[:OWN] += np.linalg.solve(held, rng.normal(size=OWN))
            own = np.sqrt(wear) * rng.normal(size=EDGES).repeat(PIECES)
            if foot is not None:
                rim = self.rows[c, :, RIM].reshape(EDGES, PIECES)
                rim[:] = FOCAL
                own += (np.sqrt(foot) * rng.normal(size=(EDGES, 1)) * self.feet[:EDGES, None] * rim).ravel()
            self.residuals[c] = self.rows[c] @ moved + own + self.NOISE * rng.normal(size=EDGES * PIECES)

    def sizes(self, own: float = 0.0, *, doubtful: bool = True) -> tuple[float, float, float, float]:
        """Both shares, and the variances of edges' own offsets and of feet."""
        weight = 1.0 / self.NOISE**2
        solution, cameras = np.zeros(1, SOLUTION)[0], np.zeros(self.count, CAMERA)
        solution["feet"], solution["own"] = self.feet, own
        solution["size"], solution["prior"][:UNKNOWNS, :UNKNOWNS] = UNKNOWNS, self.prior
        cameras["used"], cameras["scale"] = True, 1.0
        cameras["whole"] = weight * np.einsum("cri,crj->cij", self.rows, self.rows)
        cameras["force"] = weight * np.einsum("cri,cr->ci", self.rows, self.residuals)
        cameras["edges"] = [sums(*one, weight) for one in zip(self.rows, self.residuals, strict=True)]
        cameras["weights"] = np.einsum("cki,ckj->cij", self.roots, self.roots)[:, :6, :6]
        return *sizes(solution, cameras, doubtful, own == 0.0), solution["own"], solution["foot"]


def sums(rows: np.ndarray, residuals: np.ndarray, weight: float) -> np.ndarray:
    """(12, EDGE) of pieces that follow each other edge by edge."""
    edges = np.zeros((12, EDGE))
    for e in range(EDGES):
        of = slice(e * PIECES, (e + 1) * PIECES)
        edges[e, KNOWN], edges[e, PULL] = weight * PIECES, weight * residuals[of].sum()
        edges[e, ROW:] = weight * rows[of].sum(axis=0)
    return edges


@pytest.mark.parametrize("own", [1e-4, 0.01, 4.0])
@pytest.mark.parametrize("foot", [0.0, 0.3])
def test_edges_offsets_are_integrated_out_as_if_their_pieces_were_correlated(rng, own, foot):
    rows, residuals = rng.normal(size=(EDGES * PIECES, UNKNOWNS)), rng.normal(size=EDGES * PIECES)
    weight = 2.5
    cameras = np.zeros(1, CAMERA)
    cameras["used"], cameras["scale"], cameras["edges"] = True, 1.0, sums(rows, residuals, weight)
    cameras["whole"], cameras["force"] = weight * rows.T @ rows, weight * rows.T @ residuals
    unlikely = with_edges(cameras, STANDING, own, foot)
    matrix, vector = cameras["information"][0], cameras["gradient"][0]
    rim = rows[:, RIM].reshape(EDGES, PIECES).mean(axis=1)
    variances = np.diag(own + foot * STANDING[:EDGES] * rim**2)
    spread = np.kron(variances, np.ones((PIECES, PIECES))) + np.eye(EDGES * PIECES) / weight
    np.testing.assert_allclose(matrix, rows.T @ np.linalg.solve(spread, rows), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(vector, rows.T @ np.linalg.solve(spread, residuals), rtol=1e-9, atol=1e-9)
    expected = np.linalg.slogdet(weight * spread)[1] + residuals @ np.linalg.solve(spread, residuals)
    assert unlikely == pytest.approx(expected - weight * residuals @ residuals)


def test_share_is_high_where_cameras_disagree_and_low_where_they_agree(rng):
    disagreeing = [Problem(rng, 1.0).sizes()[1] for _ in range(60)]
    agreeing = [Problem(rng, 0.001).sizes()[1] for _ in range(60)]
    assert np.median(disagreeing) > 0.8
    assert np.median(agreeing) < 0.02
    assert np.quantile(agreeing, 0.95) < np.quantile(disagreeing, 0.05)


@pytest.mark.parametrize("share", [0.001, 1.0])
def test_worn_edges_are_distinguished_from_cameras_that_are_off(rng, share):
    sharp = [Problem(rng, share).sizes() for _ in range(60)]
    worn = [Problem(rng, share, 0.2**2).sizes() for _ in range(60)]
    own = [found[2] for found in worn]
    assert np.median(own) == pytest.approx(np.interp(0.2**2, WEAR, COUNTED), rel=0.4)
    assert np.quantile([found[2] for found in sharp], 0.95) < np.quantile(own, 0.05)
    low, high = np.quantile([found[1] for found in worn], [0.25, 0.75])
    assert low / 10 < share < 10 * high


def test_sizes_are_unbiased_over_their_prior(rng):
    # The mean of a posterior: no function of it tells on average which way the truth deviates.
    shares = rng.choice(SHARES, p=SHARES_PRIOR, size=1500)
    wears = rng.choice(len(WEAR), p=WEAR_PRIOR, size=1500)
    found = np.array([Problem(rng, *truth).sizes() for truth in zip(shares, WEAR[wears], strict=True)])
    assert ((found[:, 1] >= SHARES.min()) & (found[:, 1] <= SHARES.max())).all()
    for truth, mean in ((shares, found[:, 1]), (COUNTED[wears], found[:, 2])):
        for test in (np.ones_like(mean), mean, np.log(mean)):
            off = (truth - mean) * test
            assert abs(off.mean()) < 3 * off.std() / np.sqrt(len(off))


def test_a_pose_moves_under_no_share_that_is_larger_than_that(rng):
    for share in (100.0, 1.0, 0.001):
        moving, mean, *_ = Problem(rng, share).sizes()
        assert SHARES.min() <= moving <= min(SHARES[MOVING_SHARE], mean + 1e-12)


def test_what_edges_are_off_by_counts_more_often_where_more_cameras_share_it(rng):
    one, two, four = (
        np.median([Problem(rng, 1.0, 0.4**2, count).sizes()[2] for _ in range(20)]) for count in (1, 2, 4)
    )
    assert one < two < four


def test_one_camera_does_not_tell_its_share(rng):
    moving, mean, *_ = Problem(rng, 0.01, cameras=1).sizes()
    assert mean == pytest.approx(SHARES @ SHARES_PRIOR)
    assert moving == pytest.approx(np.average(SHARES[MOVING_SHARE:], weights=SHARES_PRIOR[MOVING_SHARE:]))


def test_what_is_known_of_the_edges_is_kept(rng):
    assert Problem(rng, 1.0, 0.2**2).sizes(own=0.03**2)[2] == pytest.approx(0.03**2)


def test_feet_are_found_where_colours_end_above_the_table_and_kept_where_they_do_not(rng):
    shaded = [Problem(rng, 0.001, foot=3e-3**2).sizes()[3] for _ in range(60)]
    sharp = [Problem(rng, 0.001, foot=0.0).sizes()[3] for _ in range(60)]
    assert np.median(shaded) > 0.7 * FEET[-1]
    assert np.quantile(sharp, 0.9) < 0.1 * FEET[-1]
    assert Problem(rng, 0.001).sizes()[3] == 0.0


def test_equations_that_cannot_be_solved_say_nothing(rng):
    problem = Problem(rng, 1.0)
    problem.rows[1, :, :5], problem.roots[1] = 0, 0
    assert problem.sizes() == (1.0, 1.0, WEAR[0], 0.0)


def test_probabilities_sum_to_one():
    assert SHARES_PRIOR.sum() == pytest.approx(1)
    assert WEAR_PRIOR.sum() == pytest.approx(1)
    assert FEET_PRIOR.sum() == pytest.approx(1)
    assert len(FEET) == len(FEET_PRIOR)
    assert len(SHARES) == len(SHARES_PRIOR)
    assert len(WEAR) == len(WEAR_PRIOR)
    assert (np.diff(SHARES) < 0).all()
    assert (np.diff(WEAR) > 0).all()
