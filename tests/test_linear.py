from __future__ import annotations

import numpy as np
import pytest

from tracker.pose.linear import solve_positive


@pytest.mark.parametrize("size", [3, 6])
def test_solution_is_numpys(rng, size):
    root = rng.normal(size=(size, size))
    matrix, vector, out = root @ root.T + np.eye(size), rng.normal(size=size), np.empty(size)
    assert solve_positive(matrix, vector, out)
    np.testing.assert_allclose(out, np.linalg.solve(matrix, vector), rtol=1e-9)


def test_a_matrix_that_is_not_positive_definite_is_refused(rng):
    out = np.empty(3)
    assert not solve_positive(np.diag([1.0, -1.0, 2.0]), rng.normal(size=3), out)
