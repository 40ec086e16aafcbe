"""The least squares of one strip: products of the model's columns, their Cholesky factor, solutions.

The unknowns are the colours of m surfaces, the edge's shift (the line, column m), and slopes of brightness.
Solved without the slopes first, which tells the noise and with it how stiff the slopes are; the factor's
first rows serve both. Right sides are the channels, and two columns: the effect of a change of blur, and the
shift alone, whose solution tells how well the shift is known.
"""

from __future__ import annotations

import math

from tracker.compiled import compiled
from tracker.pose.edges.profile import model

RIDGE = 0.003
"""Weight of a surface's prior colour, the mean of its pixels, against one pixel."""

BLUR, SHIFT = 3, 4
"""Right sides beyond the channels."""


@compiled(fastmath=True)
def _dot(a, b, n):  # type: ignore[no-untyped-def]
    """Sum of products of the first n; in whatever order is fastest, but always in the same."""
    total = 0.0
    for i in range(n):
        total += a[i] * b[i]
    return total


@compiled
def products(strip, g, part, shift, distance, values, m, inside, slopes, reach, blur, scratch):  # type: ignore[no-untyped-def]
    """Products of the columns with each other and with `part` channels from g on."""
    first, last = strip.first[g], strip.first[g] + strip.count[g]
    columns, full, raw, pixels = scratch.columns, scratch.full[g], scratch.raw[g], last - first
    model(distance[first:last], shift, scratch.edges, m, inside, slopes, reach, blur, columns)
    for i in range(m + slopes + 2):
        for j in range(i + 1):
            full[i, j] = _dot(columns[i], columns[j], pixels)
        for k in range(g, g + part):
            raw[i, k] = _dot(columns[i], values[k, first:last], pixels)


@compiled
def eliminate(full, raw, first, last, m, wide, g, part, stiffness, factor, half):  # type: ignore[no-untyped-def]
    """Rows first … last - 1 of the Cholesky factor and of the right sides' forward substitution.

    This is equation (9) of docs/how-it-works.md.
    The first m unknowns, surfaces' colours, are drawn a little to the mean of their pixels, those after the
    line (m) to zero with `stiffness`. The factor's diagonal holds reciprocals.
    """
    for i in range(first, last):
        for k in range(g, g + part):
            half[i, k] = raw[i, k]
        half[i, BLUR], half[i, SHIFT] = full[wide, i], 1.0 if i == m else 0.0
        diagonal = full[i, i]
        if i < m:
            total = 1e-9
            for j in range(m):
                total += full[max(i, j), min(i, j)]
            diagonal += RIDGE
            for k in range(g, g + part):
                half[i, k] += RIDGE * raw[i, k] / total
        elif i > m:
            diagonal += stiffness
        for j in range(i):
            entry = full[i, j]
            for k in range(j):
                entry -= factor[i, k] * factor[j, k]
            entry *= factor[j, j]
            factor[i, j] = entry
            diagonal -= entry * entry
            for k in range(g, g + part):
                half[i, k] -= entry * half[j, k]
            half[i, BLUR] -= entry * half[j, BLUR]
            half[i, SHIFT] -= entry * half[j, SHIFT]
        factor[i, i] = 1.0 / math.sqrt(max(diagonal, 1e-9))
        for k in range(g, g + part):
            half[i, k] *= factor[i, i]
        half[i, BLUR] *= factor[i, i]
        half[i, SHIFT] *= factor[i, i]


@compiled(inline="always")
def _substitute(factor, half, size, column, out):  # type: ignore[no-untyped-def]
    """Solve for one right side by back substitution."""
    for i in range(size - 1, -1, -1):
        value = half[i, column]
        for k in range(i + 1, size):
            value -= factor[k, i] * out[k, column]
        out[i, column] = value * factor[i, i]


@compiled
def substitute(factor, half, size, g, part, extra, out):  # type: ignore[no-untyped-def]
    """Solutions out (size, ·) for the channels from g on and for one extra column."""
    for k in range(g, g + part):
        _substitute(factor, half, size, k, out)
    _substitute(factor, half, size, extra, out)


@compiled
def misfit(full, raw, squares, size, found, first, last):  # type: ignore[no-untyped-def]
    """Sum of squared residuals over pixels and channels; squares: sum of the values' squares."""
    total = squares
    for k in range(first, last):
        for i in range(size):
            product = 0.5 * full[i, i] * found[i, k] - raw[i, k]
            for j in range(i):
                product += full[i, j] * found[j, k]
            total += 2.0 * product * found[i, k]
    return total


@compiled
def widening(full, raw, found, m, wide, inside, first, last):  # type: ignore[no-untyped-def]
    """What speaks for a change of blur that colours and shift cannot explain, and how much could.

    See equation (11) of docs/how-it-works.md.
    """
    own, wider, contrast = full[wide, wide], 0.0, 0.0
    for i in range(m + 1):
        own -= full[wide, i] * found[i, BLUR]
    if own <= 1e-3 * full[wide, wide]:
        return 0.0, 0.0
    for k in range(first, last):
        difference = found[inside, k] - found[inside + 1, k]
        contrast += difference**2
        off = raw[wide, k]
        for i in range(m + 1):
            off -= full[wide, i] * found[i, k]
        wider -= difference * off
    return wider, contrast * own
