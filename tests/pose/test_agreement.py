import math

import numpy as np
import pytest
from scipy.stats import chi2, multivariate_normal

from tests.helpers import random_rotations
from tracker.pose.agreement import (
    _FITS,
    ACROSS,
    ALONG,
    NEAR_DISTANCE,
    ROLL,
    SCALES,
    SCALES_PRIOR,
    SHARED_SHARE,
    TILT,
    _within,
    disagreement,
    probabilities,
    probably_fits,
    size,
    spread,
)
from tracker.pose.fit import OwnViews

RADIUS = 0.05
CENTRE = np.array([0.02, -0.03, 0.03])
KNOWN = 1 / np.repeat([2e-4, 4e-3], 3) ** 2
"""Information of a camera that sees the object well, the same in all directions."""


class Cameras:
    """Three cameras around an object, and what each sees of it by itself."""

    def __init__(self, moved, information=None, seed=3):
        rng = np.random.default_rng(seed)
        self.rotations = random_rotations(rng, 3)
        self.positions = CENTRE + rng.uniform(0.3, 0.6, (3, 1)) * random_rotations(rng, 3)[:, 0]
        known = np.tile(np.diag(KNOWN), (3, 1, 1)) if information is None else information
        self.views = OwnViews(known, np.asarray(moved, dtype=np.float64), np.full(3, 30.0))

    def likelihoods(self):
        return disagreement(self.views, self.rotations, self.positions, CENTRE, RADIUS)


def scattered(std, seed=5):
    """(3, 6) motions of `std` [m] along each axis, and turns as of a camera half a metre away."""
    return np.random.default_rng(seed).normal(size=(3, 6)) * np.repeat([std, std / 0.5], 3)


def full_information(seed):
    """(3, 6, 6) that couple all directions."""
    roots = np.random.default_rng(seed).normal(size=(3, 6, 6)) * np.sqrt(KNOWN)
    return roots @ roots.transpose(0, 2, 1)


def test_likelihoods_are_those_of_one_gaussian_over_all_cameras():
    for seed in range(5):
        cameras = Cameras(scattered(2e-3, seed), full_information(seed), seed)
        found = cameras.likelihoods()
        prior = np.diag([RADIUS**2 / 3] * 3 + [0.1] * 3)
        expected = []
        for scale in SCALES:
            whole = np.kron(np.ones((3, 3)), prior)
            for c in range(3):
                distance = np.linalg.norm(cameras.positions[c] - CENTRE)
                own = [scale**2 + (e * distance) ** 2 for e in (ACROSS, ACROSS, ALONG)]
                own += [(scale / distance) ** 2 + e**2 for e in (TILT, TILT, ROLL)]
                turned = np.kron(np.eye(2), cameras.rotations[c].T)
                part = slice(6 * c, 6 * c + 6)
                whole[part, part] += np.linalg.inv(cameras.views.information[c])
                whole[part, part] += turned @ np.diag(own) @ turned.T
            expected.append(multivariate_normal(cov=whole).logpdf(cameras.views.moved.ravel()))
        np.testing.assert_allclose(np.diff(found), np.diff(expected), rtol=1e-6, atol=1e-6)


def test_cameras_that_agree_are_taken_to_be_exact_and_others_to_be_off_by_what_they_disagree():
    sizes = [np.median([size(Cameras(scattered(std, k)).likelihoods()) for k in range(9)]) for std in SCALES]
    assert sizes == sorted(sizes)
    for std, found in zip(SCALES[4:-2], sizes[4:-2], strict=True):
        assert std / 2 < found < 2 * std
    assert size(Cameras(np.zeros((3, 6))).likelihoods()) < SCALES[2]


def test_a_motion_that_all_cameras_see_is_no_disagreement():
    # Up to what the prior on the joint pose pays for it.
    common = np.tile([0.5e-3, -0.3e-3, 0.4e-3, 0.002, 0.001, -0.003], (3, 1))
    together, still = (Cameras(moved).likelihoods() for moved in (common, np.zeros((3, 6))))
    np.testing.assert_allclose(np.diff(together), np.diff(still), atol=0.01)


def test_a_camera_that_tells_little_is_no_evidence():
    moved = scattered(1e-4)
    moved[2] = 0.02
    known = np.tile(np.diag(KNOWN), (3, 1, 1))
    assert size(Cameras(moved, known).likelihoods()) > 3e-3
    known[2] *= 1e-6
    assert size(Cameras(moved, known).likelihoods()) < 5e-4
    known[2] = 0.0
    assert size(Cameras(moved, known).likelihoods()) < 5e-4


def test_no_cameras_view_leaves_what_was_believed_before():
    nothing = Cameras(np.zeros((3, 6)), np.zeros((3, 6, 6))).likelihoods()
    np.testing.assert_allclose(nothing, nothing[0])
    np.testing.assert_allclose(probabilities(nothing), SCALES_PRIOR / SCALES_PRIOR.sum())
    assert probably_fits(nothing) == pytest.approx(SCALES_PRIOR @ _FITS / SCALES_PRIOR.sum())


def test_the_probability_of_being_near_falls_as_cameras_disagree():
    found = [probably_fits(Cameras(scattered(std)).likelihoods()) for std in SCALES]
    assert found == sorted(found, reverse=True)
    assert found[0] > 0.99
    assert found[-1] < 0.05
    assert probabilities(Cameras(scattered(1e-3)).likelihoods()).sum() == pytest.approx(1.0)


def test_three_normal_deviates_are_near_together_as_chi_square_has_it():
    std = np.geomspace(1e-4, 0.1, 12)
    np.testing.assert_allclose(_within(std), chi2.cdf((NEAR_DISTANCE / std) ** 2, 3), atol=1e-9)


def test_the_spread_is_that_of_the_errors():
    assert spread(None) == 0.0
    stds = [math.sqrt(spread(np.where(scale == SCALES, 0.0, -50.0))) for scale in SCALES]
    np.testing.assert_allclose(stds, SHARED_SHARE * SCALES, rtol=1e-6)
