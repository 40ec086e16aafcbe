"""Small compiled linear algebra; NumPy's would take long to compile into kernels, and to load with them."""

import math

import numpy as np

from tracker.compiled import compiled


@compiled
def factorise(matrix, lower):  # type: ignore[no-untyped-def]
    """Fill lower (n, n) with the Cholesky factor of a symmetric matrix (n, n); only its lower half is read.

    Return False, and leave `lower` undefined, if the matrix is not positive definite.
    """
    for i in range(len(lower)):
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
    """Set out (n,) = (lower · lowerᵀ)⁻¹ vector; `out` may be `vector` itself."""
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
def invert(lower, out):  # type: ignore[no-untyped-def]
    """Set out (n, n) = (lower · lowerᵀ)⁻¹."""
    out[:, :] = 0.0
    for k in range(len(lower)):
        out[k, k] = 1.0
        substitute(lower, out[:, k], out[:, k])


@compiled
def solve_positive(matrix, vector, out):  # type: ignore[no-untyped-def]
    """Set out (n,) = matrix⁻¹ vector for a positive definite matrix (n, n); only its lower half is read.

    Return False, and leave `out` undefined, if the matrix is not positive definite.
    """
    lower = np.zeros((len(vector), len(vector)))
    if not factorise(matrix, lower):
        return False
    substitute(lower, vector, out)
    return True


@compiled
def product(a, b, out):  # type: ignore[no-untyped-def]
    """Set out (n, m) = a (n, k) · b (k, m)."""
    for i in range(a.shape[0]):
        for j in range(b.shape[1]):
            total = 0.0
            for k in range(a.shape[1]):
                total += a[i, k] * b[k, j]
            out[i, j] = total


@compiled
def congruence(a, b, out):  # type: ignore[no-untyped-def]
    """Add a (n, k) · b (k, k) · aᵀ for a symmetric b to out (n, n), keeping it exactly symmetric."""
    n, size = a.shape
    row = np.empty(size)
    for i in range(n):
        for k in range(size):
            total = 0.0
            for j in range(size):
                total += a[i, j] * b[j, k]
            row[k] = total
        for m in range(i + 1):
            total = 0.0
            for k in range(size):
                total += row[k] * a[m, k]
            out[i, m] += total
            if m < i:
                out[m, i] += total


@compiled
def sum_from(values, first):  # type: ignore[no-untyped-def]
    """Return the sum of the values (n,) from the one with index `first` on."""
    result = 0
    for i in range(first, len(values)):
        result += values[i]
    return result


@compiled
def smallest(values):  # type: ignore[no-untyped-def]
    """Return the index of the smallest value (n,)."""
    best = 0
    for i in range(len(values)):
        if values[i] < values[best]:
            best = i
    return best


@compiled
def median(values, n):  # type: ignore[no-untyped-def]
    """Return the median of the first n > 0 values by Hoare's selection, which reorders them."""
    low, high, middle = 0, n - 1, n // 2
    while low < high:
        pivot, i, j = values[(low + high) // 2], low, high
        while i <= j:
            while values[i] < pivot:
                i += 1
            while values[j] > pivot:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                i += 1
                j -= 1
        if middle <= j:
            high = j
        else:
            low = i
    upper = values[middle]
    if n % 2:
        return upper
    lower = values[0]
    for i in range(1, middle):
        lower = max(lower, values[i])
    return 0.5 * (lower + upper)
