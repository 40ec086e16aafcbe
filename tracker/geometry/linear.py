"""Small compiled solvers; NumPy's would take seconds to compile into the kernels."""

from __future__ import annotations

import math

import numpy as np

from tracker.compiled import compiled


@compiled
def factorise(matrix, lower):  # type: ignore[no-untyped-def]
    """Lower (n, n) = Cholesky factor of a symmetric matrix (n, n), of which the lower half is read.

    Returns False, and leaves `lower` undefined, where the matrix is not positive definite.
    """
    for i in range(matrix.shape[0]):
        for j in range(i + 1):
            total = matrix[i, j]
            for k in range(j):
                total -= lower[i, k] * lower[j, k]
            if i > j:
                lower[i, j] = total / lower[j, j]
            elif total > 0.0:
                lower[i, i] = math.sqrt(total)
            else:
                return False
    return True


@compiled
def substitute(lower, vector, out):  # type: ignore[no-untyped-def]
    """Out (n,) = (lower · lowerᵀ)⁻¹ vector; out may be vector."""
    n = len(vector)
    for i in range(n):
        total = vector[i]
        for k in range(i):
            total -= lower[i, k] * out[k]
        out[i] = total / lower[i, i]
    for i in range(n - 1, -1, -1):
        total = out[i]
        for k in range(i + 1, n):
            total -= lower[k, i] * out[k]
        out[i] = total / lower[i, i]


@compiled
def solve_positive(matrix, vector, out):  # type: ignore[no-untyped-def]
    """Out (n,) = matrix⁻¹ vector for a positive definite matrix (n, n), of which the lower half is read.

    Returns False, and leaves out undefined, where the matrix is not positive definite.
    """
    lower = np.zeros((len(vector), len(vector)))
    if not factorise(matrix, lower):
        return False
    substitute(lower, vector, out)
    return True
