import numpy as np
import pytest

from tracker.pose import sizes
from tracker.pose.sizes import ALIKE, FEET, SHARES, SHARES_PRIOR, WEAR, WEAR_PRIOR
from tracker.pose.solution import CAMERA, EDGE, EXPONENT, KNOWN, OWN, PULL, RIM, ROW, SOLUTION, UNKNOWNS
from tracker.pose.solve import DEVIATION_STD, with_edges

CAMERAS, EDGES, PIECES = 3, 9, 6
NOISE = 0.05  # [px]
FOCAL = 500.0  # offset of an edge per metre by which its colours end too early [px/m]
SEEN_ALIKE = 2.5
COUNTED = WEAR + ALIKE[0] * (1 - ALIKE[1] / CAMERAS) * (SEEN_ALIKE / ALIKE[2]) ** 2 * sizes.WORN
STANDING = np.array([1.0, 1.0] + 10 * [0.0])


class Problem:
    """Measurements as they come about: unknowns from their prior, offsets of cameras and edges, noise."""

    def __init__(self, rng, share, wear=0.0, cameras=CAMERAS, foot=None):
        self.count, self.feet = cameras, np.zeros(12) if foot is None else STANDING
        self.rows = 3.0 * NOISE * rng.normal(size=(cameras, EDGES * PIECES, UNKNOWNS))
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
            self.residuals[c] = self.rows[c] @ moved + own + NOISE * rng.normal(size=EDGES * PIECES)

    def sizes(self, own=0.0):
        """The share, and the variances of edges' own offsets and of feet."""
        weight = 1.0 / NOISE**2
        solution, cameras = np.zeros(1, SOLUTION)[0], np.zeros(self.count, CAMERA)
        solution["feet"], solution["own"] = self.feet, own
        solution["size"], solution["prior"][:UNKNOWNS, :UNKNOWNS] = UNKNOWNS, self.prior
        cameras["used"], cameras["scale"] = True, 1.0
        cameras["sight"] = np.sqrt(SEEN_ALIKE / self.count / 3)
        cameras["whole"] = weight * np.einsum("cri,crj->cij", self.rows, self.rows)
        cameras["force"] = weight * np.einsum("cri,cr->ci", self.rows, self.residuals)
        cameras["edges"] = [sums(*one, weight) for one in zip(self.rows, self.residuals, strict=True)]
        cameras["weights"] = np.einsum("cki,ckj->cij", self.roots, self.roots)[:, :6, :6]
        return sizes.sizes(solution, cameras, True, own == 0.0), solution["own"], solution["foot"]


def found(rng, *problem, count=60, **more):
    """Sizes (3, count) of so many problems."""
    return np.transpose([Problem(rng, *problem, **more).sizes() for _ in range(count)])


def sums(rows, residuals, weight):
    """(12, EDGE) of pieces that follow each other edge by edge."""
    edges = np.zeros((12, EDGE))
    edges[:EDGES, KNOWN] = weight * PIECES
    edges[:EDGES, PULL] = weight * residuals.reshape(EDGES, PIECES).sum(axis=1)
    edges[:EDGES, ROW:] = weight * rows.reshape(EDGES, PIECES, -1).sum(axis=1)
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
    far, disagreeing, agreeing = (found(rng, share)[0] for share in (100.0, 1.0, 0.001))
    assert np.median(far) > 10.0
    assert np.median(disagreeing) > 0.8
    assert np.median(agreeing) < 0.02
    assert np.quantile(agreeing, 0.95) < np.quantile(disagreeing, 0.05)


@pytest.mark.parametrize("share", [0.001, 1.0])
def test_worn_edges_are_distinguished_from_cameras_that_are_off_and_what_is_known_is_kept(rng, share):
    sharp, worn = (found(rng, share, wear) for wear in (0.0, 0.2**2))
    assert np.median(worn[1]) == pytest.approx(np.interp(0.2**2, WEAR, COUNTED), rel=0.4)
    assert np.quantile(sharp[1], 0.95) < np.quantile(worn[1], 0.05)
    low, high = np.quantile(worn[0], [0.25, 0.75])
    assert low / 10 < share < 10 * high
    assert Problem(rng, share, 0.2**2).sizes(own=0.03**2)[1] == pytest.approx(0.03**2)


def test_sizes_are_unbiased_over_their_prior(rng):
    # The mean of a posterior: no function of it tells on average which way the truth deviates.
    shares = rng.choice(SHARES, p=SHARES_PRIOR, size=1500)
    wears = rng.choice(len(WEAR), p=WEAR_PRIOR, size=1500)
    results = [Problem(rng, *truth).sizes() for truth in zip(shares, WEAR[wears], strict=True)]
    means, own, _ = np.transpose(results)
    assert ((means >= SHARES.min()) & (means <= SHARES.max())).all()
    for truth, mean in ((shares, means), (COUNTED[wears], own)):
        for test in (np.ones_like(mean), mean, np.log(mean)):
            off = (truth - mean) * test
            assert abs(off.mean()) < 3 * off.std() / np.sqrt(len(off))


def test_what_edges_are_off_by_counts_more_often_where_more_cameras_share_it(rng):
    one, two, four = (np.median(found(rng, 1.0, 0.4**2, cameras, count=20)[1]) for cameras in (1, 2, 4))
    assert one < two < four


def test_one_camera_does_not_tell_its_share(rng):
    assert Problem(rng, 0.01, cameras=1).sizes()[0] == pytest.approx(SHARES @ SHARES_PRIOR)
    # Equations that cannot be solved say nothing.
    problem = Problem(rng, 1.0)
    problem.rows[1, :, :5], problem.roots[1] = 0, 0
    assert problem.sizes() == (1.0, WEAR[0], 0.0)


def test_feet_are_found_where_colours_end_above_the_table_and_kept_where_they_do_not(rng):
    shaded, sharp = (found(rng, 0.001, foot=foot)[2] for foot in (3e-3**2, 0.0))
    assert np.median(shaded) > 0.7 * FEET[-1]
    assert np.quantile(sharp, 0.9) < 0.1 * FEET[-1]
    assert Problem(rng, 0.001).sizes()[2] == 0.0


def test_probabilities_sum_to_one():
    for values, prior in ((SHARES, SHARES_PRIOR), (WEAR, WEAR_PRIOR), (FEET, sizes.FEET_PRIOR)):
        assert prior.sum() == pytest.approx(1)
        assert len(values) == len(prior)
    assert (np.diff(SHARES) < 0).all()
    assert (np.diff(WEAR) > 0).all()
