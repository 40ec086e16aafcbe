import math

import numpy as np
import pytest
from scipy.stats import chi2

from tests.helpers import random_rotations
from tracker.geometry.probability import mass_within, probability_within

CLOSE = 0.01
"""Of a probability, more than what its sum over directions leaves open."""

ISOTROPIC = np.array([0.4, 0.8, 1.2, 1.6, 2.0, 2.6, 3.5, 1e3])
"""Limits in standard deviations."""


def random_covariance(rng, spread=1.0):
    """Correlated covariance (6, 6) of about [1 mm, 1 degree], with axes that differ by e**spread."""
    root = rng.normal(size=(6, 6)) * np.exp(spread * rng.normal(size=6))[:, None]
    units = np.repeat([1e-3, math.radians(1)], 3)
    covariance = root @ root.T / 6 + 0.05 * np.eye(6)
    return covariance * np.outer(units, units)


def typical_limits(covariance, rng):
    """Limits for which neither norm is certain: in root mean squares of each."""
    sizes = np.sqrt([np.trace(covariance[:3, :3]), np.trace(covariance[3:, 3:])])
    return sizes * rng.uniform(0.4, 2.0, 2)


@pytest.mark.parametrize("k", ISOTROPIC)
@pytest.mark.parametrize("n", ISOTROPIC)
@pytest.mark.parametrize(("freedoms", "close"), [(3, CLOSE), (2, 2 * CLOSE), (1, 2 * CLOSE)])
def test_errors_along_some_axes_follow_chi_squares_of_as_many_freedoms(k, n, freedoms, close):
    sigma, tau = 2e-3, 0.03
    variances = np.array([sigma**2] * freedoms + [1e-16] * (3 - freedoms) + [tau**2] * 3)
    exact = chi2(freedoms).cdf(k**2) * chi2(3).cdf(n**2)
    assert probability_within(np.diag(variances), k * sigma, n * tau) == pytest.approx(exact, abs=close)


@pytest.mark.parametrize("seed", range(12))
def test_correlated_errors_agree_with_samples(seed):
    rng = np.random.default_rng([71, seed])
    covariance = random_covariance(rng, spread=0.5 * (seed % 3))
    near, turned = typical_limits(covariance, rng)
    errors = rng.normal(size=(200_000, 6)) @ np.linalg.cholesky(covariance).T
    inside = np.linalg.norm(errors[:, :3], axis=1) < near
    inside &= np.linalg.norm(errors[:, 3:], axis=1) < turned
    assert probability_within(covariance, near, turned) == pytest.approx(inside.mean(), abs=CLOSE)


def test_wider_limits_are_never_less_probable_and_greater_covariances_never_more():
    rng = np.random.default_rng(73)
    for _ in range(10):
        covariance = random_covariance(rng)
        near, turned = typical_limits(covariance, rng)
        factors = np.concatenate([[0.0], np.geomspace(1e-3, 1e3, 40)])
        for found in (
            [probability_within(covariance, near * factor, turned) for factor in factors],
            [probability_within(covariance, near, turned * factor) for factor in factors],
            [probability_within(covariance, near * factor, turned * factor) for factor in factors],
        ):
            # What is certain is one; just below it the sum is.
            assert (np.diff(found) >= -1e-9).all()
            assert min(found) >= 0.0
            assert max(found) <= 1.0
        found = [probability_within(size * covariance, near, turned) for size in np.geomspace(1e-4, 1e4, 40)]
        assert (np.diff(found) <= 1e-9).all()


def test_axes_units_and_memory_layout_do_not_matter():
    rng, units = np.random.default_rng(75), np.repeat([1e3, 57.3], 3)
    for rotation in random_rotations(rng, 20):
        covariance = random_covariance(rng, spread=0.5)
        near, turned = typical_limits(covariance, rng)
        expected = probability_within(covariance, near, turned)
        both = np.kron(np.eye(2), rotation)
        elsewhere = probability_within(both @ covariance @ both.T, near, turned)
        assert elsewhere == pytest.approx(expected, abs=CLOSE)
        scaled = probability_within(covariance * np.outer(units, units), 1e3 * near, 57.3 * turned)
        assert scaled == pytest.approx(expected, abs=1e-9)
        larger = np.zeros((12, 12))
        larger[:6, :6] = covariance
        for same in (np.asfortranarray(covariance), larger[:6, :6]):
            assert probability_within(same, near, turned) == expected


@pytest.mark.parametrize("size", [1e5, 1e8, 1e12])
def test_tiny_errors_are_certainly_within_the_limits_and_huge_ones_hardly_ever(size):
    covariance = random_covariance(np.random.default_rng(77))
    assert probability_within(covariance / size, 5e-3, math.radians(5)) == 1.0
    assert 0.0 <= probability_within(covariance * size, 5e-3, math.radians(5)) < 1e-3
    for factor in np.geomspace(1e-3, 0.1, 80):
        rounded = factor * size * np.diag([1.0] * 3 + [0.01] * 3)
        assert probability_within(rounded, 5e-3, math.radians(5)) >= 0.0


@pytest.mark.parametrize(
    "variances",
    [
        *([value] * 6 for value in (np.nan, 0.0, -1e-7)),
        *([1e-4] * 5 + [-1.0], [1e-10] * 5 + [-1e-10], [-1e-10] + [1e-10] * 5),
    ],
)
def test_a_covariance_that_is_none_gives_no_probability(variances):
    assert probability_within(np.diag(variances), 5e-3, math.radians(5)) == 0.0


def test_neither_a_covariance_that_cannot_be_written_nor_whole_limits_compile_anything_again():
    covariance = random_covariance(np.random.default_rng(75))
    expected, count = probability_within(covariance, 1.0, 2.0), len(mass_within.signatures)
    covariance.flags.writeable = False
    for same in (covariance, np.asfortranarray(covariance)):
        assert probability_within(same, 1, 2) == expected
    assert len(mass_within.signatures) == count
