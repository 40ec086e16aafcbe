"""The place of an edge from the colour profile across it, to a fraction of a pixel.

Across an edge the image is a sum of blurred steps between surfaces of locally constant colour: the
face inside, the face or background outside, and, where a face is narrow, what lies beyond it. With
the steps where the pose puts them the colours follow from linear least squares, shared among
neighbouring samples of the edge; what is left over in the shape of the edge's own blurred line is its
offset. Gains, exposure and shading cancel because only the profile's own colours count, and a narrow
face is told apart from its neighbours' blur.

The idea of local colour statistics on both sides of a contour is that of R. Hanek and M. Beetz, "The
Contracting Curve Density Algorithm", IJCV 59(3), 2004; here the colours are eliminated in closed form
and each sample yields one offset.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from tracker.pose.edges import INSIDE, MAX_SAMPLES, NU, NV, OUTSIDE, REACH_IN, REACH_OUT, U, V

MIN_CONTRAST = 14.0
"""Least distance between the two surfaces' colours [levels]."""

MAX_REACH = 24
"""Longest half profile [px]."""

RIDGE = 0.02
"""Weight of a surface's prior colour, which is that in the middle of its stretch, against one reading."""

NEIGHBOURS = 2
"""Samples to either side that share their colours with one."""

OFFSET, VARIANCE, VALID, BLUR = 0, 1, 2, 3
"""Columns of a measurement: offset along the normal [px], its variance from noise [px²], 1 if usable,
the blur that the profile shows [px] (0: not measurable)."""

_TABLE = 256
_SPAN = 4.0
_X = np.linspace(-_SPAN, _SPAN, 2 * _TABLE + 1)
_STEP = np.array([0.5 * (1 + math.erf(x / math.sqrt(2))) for x in _X])


@numba.njit(cache=True, nogil=True, inline="always")
def _step(x):  # type: ignore[no-untyped-def]
    """Normal distribution function, from a table."""
    if x <= -_SPAN:
        return 0.0
    if x >= _SPAN:
        return 1.0
    p = (x + _SPAN) * (_TABLE / _SPAN)
    i = int(p)
    return _STEP[i] + (p - i) * (_STEP[i + 1] - _STEP[i])


@numba.njit(cache=True, nogil=True)
def read_profiles(image, samples, n, reach, profiles, readable):  # type: ignore[no-untyped-def]
    """Bilinear readings along each normal: profiles (n, 2·reach + 1, 3); readable (n,) bool."""
    height, width = image.shape[0], image.shape[1]
    for s in range(n):
        u, v, nu, nv = samples[s, U], samples[s, V], samples[s, NU], samples[s, NV]
        u0, v0, u1, v1 = u - reach * nu, v - reach * nv, u + reach * nu, v + reach * nv
        readable[s] = min(u0, u1) >= 0 and min(v0, v1) >= 0
        readable[s] &= max(u0, u1) < width - 1 and max(v0, v1) < height - 1
        if not readable[s]:
            continue
        for t in range(2 * reach + 1):
            x, y = u0 + t * nu, v0 + t * nv
            i, j = int(x), int(y)
            a, b = x - i, y - j
            w00, w10, w01, w11 = (1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b
            for k in range(3):
                profiles[s, t, k] = (
                    w00 * image[j, i, k]
                    + w10 * image[j, i + 1, k]
                    + w01 * image[j + 1, i, k]
                    + w11 * image[j + 1, i + 1, k]
                )


@numba.njit(cache=True, nogil=True)
def _solve(matrix, rhs, m):  # type: ignore[no-untyped-def]
    """Solve the symmetric positive definite m×m system for three right-hand sides (m, 3), in place."""
    for i in range(m):
        for j in range(i + 1):
            total = matrix[i, j]
            for k in range(j):
                total -= matrix[i, k] * matrix[j, k]
            if i == j:
                matrix[i, i] = math.sqrt(max(total, 1e-9))
            else:
                matrix[i, j] = total / matrix[j, j]
    for ch in range(3):
        for i in range(m):
            for k in range(i):
                rhs[i, ch] -= matrix[i, k] * rhs[k, ch]
            rhs[i, ch] /= matrix[i, i]
        for i in range(m - 1, -1, -1):
            for k in range(i + 1, m):
                rhs[i, ch] -= matrix[k, i] * rhs[k, ch]
            rhs[i, ch] /= matrix[i, i]


@numba.njit(cache=True, nogil=True, inline="always")
def _cell(channels, color):  # type: ignore[no-untyped-def]
    total = 0
    for k in range(3):
        total += channels[k, int(min(255.0, max(0.0, color[k] + 0.5)))]
    return total


@numba.njit(cache=True, nogil=True)
def measure(channels, table, samples, n, reach, blur, noise, profiles, readable, out):  # type: ignore[no-untyped-def]
    """Offsets of n edge samples: out (n, 4), see OFFSET and below.

    reach: half length of the profiles [px]; blur: standard deviation of the steps [px]; noise: of a
    reading [levels].
    """
    size = 2 * reach + 1
    basis = np.empty((size, 5))
    matrix, rhs = np.empty((5, 5)), np.empty((5, 3))
    edges = np.empty(5)
    mean = np.empty((size, 3))
    for s in range(n):
        out[s, VALID] = 0.0
        out[s, BLUR] = 0.0
        if not readable[s]:
            continue
        row = samples[s]
        # The mean profile of the neighbours on the same edge carries the colours.
        shared = 0
        mean[:] = 0.0
        for q in range(max(0, s - NEIGHBOURS), min(n, s + NEIGHBOURS + 1)):
            if not readable[q] or samples[q, INSIDE] != row[INSIDE] or samples[q, OUTSIDE] != row[OUTSIDE]:
                continue
            if samples[q, NU] * row[NU] + samples[q, NV] * row[NV] < 0.9:
                continue
            shared += 1
            for t in range(size):
                for k in range(3):
                    mean[t, k] += profiles[q, t, k]
        for t in range(size):
            for k in range(3):
                mean[t, k] /= shared
        # Stretches of one surface each, between the edges that cross the profile.
        seen = reach + 1.5 * blur
        m, inside = 0, 0
        edges[0] = -1e3
        if row[REACH_IN] < seen:
            edges[1], inside = -row[REACH_IN], 1
        edges[inside + 1] = 0.0
        m = inside + 2
        if row[REACH_OUT] < seen:
            edges[m] = row[REACH_OUT]
            m += 1
        edges[m] = 1e3
        for t in range(size):
            x = t - reach
            before = 1.0
            for i in range(m):
                after = _step((x - edges[i + 1]) / blur) if i + 1 < m else 0.0
                basis[t, i] = before - after
                before = after
            z = x / blur
            basis[t, m] = math.exp(-0.5 * z * z) / (blur * 2.5066282746)
        for i in range(m + 1):
            for j in range(i + 1):
                total = 0.0
                for t in range(size):
                    total += basis[t, i] * basis[t, j]
                matrix[i, j] = total
            for k in range(3):
                total = 0.0
                for t in range(size):
                    total += basis[t, i] * mean[t, k]
                rhs[i, k] = total
            matrix[i, i] += RIDGE
            if i < m:
                left, right = max(edges[i], -reach - 0.5), min(edges[i + 1], reach + 0.5)
                middle = int(min(size - 1.0, max(0.0, 0.5 * (left + right) + reach + 0.5)))
                for k in range(3):
                    rhs[i, k] += RIDGE * mean[middle, k]
        _solve(matrix, rhs, m + 1)
        # The surface inside must be the face: a finger's edge is none of the object's.
        here, there = table[_cell(channels, rhs[inside])], table[_cell(channels, rhs[inside + 1])]
        if here != row[INSIDE] or (there != row[OUTSIDE] if row[OUTSIDE] > 0 else there == row[INSIDE]):
            continue
        contrast = 0.0
        for k in range(3):
            contrast += (rhs[inside + 1, k] - rhs[inside, k]) ** 2
        if contrast < MIN_CONTRAST**2:
            continue
        shift, energy = 0.0, 0.0
        for t in range(size):
            line = basis[t, m]
            energy += line * line
            along = 0.0
            for k in range(3):
                model = 0.0
                for i in range(m):
                    model += basis[t, i] * rhs[i, k]
                along += (profiles[s, t, k] - model) * (rhs[inside, k] - rhs[inside + 1, k])
            shift += line * along
        out[s, OFFSET] = min(float(reach), max(-float(reach), shift / (energy * contrast)))
        out[s, VARIANCE] = noise * noise / (contrast * energy) * (1.0 + 1.0 / shared)
        out[s, VALID] = 1.0
        if m == 2 and abs(out[s, OFFSET]) < 0.5:
            # The area between a blurred and a sharp step is 2/√(2π) of the blur.
            area = 0.0
            for t in range(size):
                x = t - reach - out[s, OFFSET]
                along = 0.0
                for k in range(3):
                    along += (profiles[s, t, k] - rhs[0, k]) * (rhs[1, k] - rhs[0, k])
                area += abs(along / contrast - (1.0 if x > 0 else 0.0))
            out[s, BLUR] = area * 1.2533141373


__all__ = ["MAX_SAMPLES", "measure", "read_profiles"]
