from __future__ import annotations

import numpy as np
import pytest

from tracker.geometry.linear import factorise, solve_positive, substitute

SIZES = [1, 3, 6, 8]


def positive(rng: np.random.Generator, size: int) -> np.ndarray:
    root = rng.normal(size=(size, size))
    return root @ root.T + np.eye(size)


@pytest.mark.parametrize("size", SIZES)
def test_solution_is_numpys(rng, size):
    matrix, vector, out = positive(rng, size), rng.normal(size=size), np.empty(size)
    assert solve_positive(matrix, vector, out)
    np.testing.assert_allclose(out, np.linalg.solve(matrix, vector), rtol=1e-9)


@pytest.mark.parametrize("size", SIZES)
def test_factor_is_numpys(rng, size):
    matrix, lower = positive(rng, size), np.zeros((size, size))
    assert factorise(matrix, lower)
    np.testing.assert_allclose(lower, np.linalg.cholesky(matrix), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("size", SIZES)
def test_only_lower_halves_are_read(rng, size):
    matrix, vector, lower = positive(rng, size), rng.normal(size=size), np.full((size, size), np.nan)
    expected, out = np.linalg.solve(matrix, vector), np.empty(size)
    matrix[np.triu_indices(size, 1)] = np.nan
    assert factorise(matrix, lower)
    substitute(lower, vector, out)
    np.testing.assert_allclose(out, expected, rtol=1e-9)


def test_vector_may_be_overwritten_with_the_solution(rng):
    matrix, vector, lower = positive(rng, 6), rng.normal(size=6), np.zeros((6, 6))
    expected = np.linalg.solve(matrix, vector)
    assert factorise(matrix, lower)
    substitute(lower, vector, vector)
    np.testing.assert_allclose(vector, expected, rtol=1e-9)


@pytest.mark.parametrize(
    "matrix", [np.diag([1.0, -1.0, 2.0]), np.ones((3, 3)), np.zeros((3, 3)), np.full((3, 3), np.nan)]
)
def test_a_matrix_that_is_not_positive_definite_is_refused(rng, matrix):
    assert not solve_positive(matrix, rng.normal(size=3), np.empty(3))
    assert not factorise(matrix, np.empty((3, 3)))
