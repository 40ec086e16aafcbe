"""The place of an edge from the pixels around it, to a fraction of one.

Near an edge the image is a sum of blurred steps between surfaces of locally constant colour: the face
inside, the face or background outside, and, where a face is narrow, what lies beyond it. With the steps
where the pose puts them, the colours and a small shift of the edge follow together from linear least
squares over the pixels themselves. Gains, exposure and shading cancel because only the colours on the spot
count, and a narrow face is told apart from its neighbours' blur.

The idea of local colour statistics on both sides of a contour is that of R. Hanek and M. Beetz, "The
Contracting Curve Density Algorithm", IJCV 59(3), 2004; here the colours are eliminated in closed form
and each piece of an edge yields one offset.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from tracker.pose.edges import INSIDE, LENGTH, NU, NV, OUTSIDE, REACH_IN, REACH_OUT, U, V

MIN_CONTRAST = 14.0
"""Least distance between the two surfaces' colours [levels]."""

RIDGE = 0.05
"""Weight of a surface's prior colour, the mean of its pixels, against one pixel."""

SLOPE = 2.0
MIN_PIXELS = 8
"""Pixels of a piece of an edge below which nothing is measured."""

OFFSET, VARIANCE, VALID, BLOOM, WIDER, SHARPNESS = range(6)
MEASURED = 6
"""Columns of a measurement: offset along the normal [px], its variance from noise [px²], 1 if usable, the
offset that a response of exponent 2 instead of 1 would feign [px], by how much the edge looks wider than
the blur [px], and the weight of that."""

_PER_UNIT = 256
_SPAN = 4.0
_X = (np.arange(int(2 * _SPAN * _PER_UNIT) + 1)) / _PER_UNIT - _SPAN
_STEP = np.array([0.5 * (1 + math.erf(x / math.sqrt(2))) for x in _X])
_LINE = np.exp(-0.5 * _X**2) / math.sqrt(2 * math.pi)

_BLOOM = math.sqrt(math.pi) / 6
"""A response of exponent γ lifts the middle of an edge by (γ - 1)/2 · Δ²/mean · w (1 - w), with w the
step; the mean of w (1 - w) is 1/6, and the line's energy 1/(2√π blur)."""


@numba.njit(cache=True, nogil=True, inline="always")
def _place(z):  # type: ignore[no-untyped-def]
    """Index of z in the tables of step and line."""
    return int((min(max(z, -_SPAN), _SPAN) + _SPAN) * _PER_UNIT + 0.5)


@numba.njit(cache=True, nogil=True)
def _solve(matrix, rhs, m):  # type: ignore[no-untyped-def]
    """Solve the symmetric positive definite m×m system for four right-hand sides (m, 4), in place.

    Returns the last diagonal element of the inverse.
    """
    for i in range(m):
        for j in range(i + 1):
            total = matrix[i, j]
            for k in range(j):
                total -= matrix[i, k] * matrix[j, k]
            if i == j:
                matrix[i, i] = math.sqrt(max(total, 1e-9))
            else:
                matrix[i, j] = total / matrix[j, j]
    for ch in range(4):
        for i in range(m):
            for k in range(i):
                rhs[i, ch] -= matrix[i, k] * rhs[k, ch]
            rhs[i, ch] /= matrix[i, i]
        for i in range(m - 1, -1, -1):
            for k in range(i + 1, m):
                rhs[i, ch] -= matrix[k, i] * rhs[k, ch]
            rhs[i, ch] /= matrix[i, i]
    return 1.0 / matrix[m - 1, m - 1] ** 2


@numba.njit(cache=True, nogil=True, inline="always")
def _label(channels, table, color):  # type: ignore[no-untyped-def]
    cell = 0
    for k in range(3):
        cell += channels[k, int(min(255.0, max(0.0, color[k] + 0.5)))]
    return table[cell]


@numba.njit(cache=True, nogil=True)
def measure(image, width, height, channels, table, samples, n, reach, blur, noise, out):  # type: ignore[no-untyped-def]
    """Offsets of n pieces of edges: out (n, MEASURED), see OFFSET and below.

    image: (≥ height, ≥ width, 3); reach: half width of the strip of pixels along an edge [px]; blur:
    standard deviation of the steps [px]; noise: least of a pixel's channel [levels].
    """
    matrix, full = np.empty((8, 8)), np.empty((8, 8))
    rhs, raw = np.empty((8, 4)), np.empty((8, 3))
    edges, basis, squares = np.empty(5), np.empty(8), np.empty(3)
    scale = 1.0 / blur
    slope = SLOPE * min(1.0, max(1e-3, (blur - 0.3) / 0.4))
    for s in range(n):
        out[s, VALID], out[s, SHARPNESS] = 0.0, 0.0
        row = samples[s]
        u, v, nu, nv, along = row[U], row[V], row[NU], row[NV], 0.5 * row[LENGTH]
        # Bounds of the oriented strip.
        du, dv = abs(nu) * reach + abs(nv) * along, abs(nv) * reach + abs(nu) * along
        if u - du < 0.0 or v - dv < 0.0 or u + du > width - 1.0 or v + dv > height - 1.0:
            continue
        # Stretches of one surface each, between the edges that cross the strip.
        seen = reach + 1.5 * blur
        inside = 0
        if row[REACH_IN] < seen:
            edges[1], inside = -row[REACH_IN], 1
        edges[inside + 1] = 0.0
        m = inside + 2
        if row[REACH_OUT] < seen:
            edges[m] = row[REACH_OUT]
            m += 1
        g = 2 if row[OUTSIDE] == 0 else 0
        t = m + g
        size = t + 2
        for i in range(size):
            for j in range(i + 1):
                full[i, j] = 0.0
            for k in range(3):
                raw[i, k] = 0.0
        for k in range(3):
            squares[k] = 0.0
        pixels = 0
        for j in range(int(math.ceil(v - dv)), int(v + dv) + 1):
            y = j - v
            # The part of the row whose pixels lie in the strip.
            low, high = u - du, u + du
            if abs(nu) > 1e-9:
                one, two = (-reach - y * nv) / nu, (reach - y * nv) / nu
                low, high = max(low, u + min(one, two)), min(high, u + max(one, two))
            if abs(nv) > 1e-9:
                one, two = (y * nu - along) / nv, (y * nu + along) / nv
                low, high = max(low, u + min(one, two)), min(high, u + max(one, two))
            for i in range(int(math.ceil(low)), int(math.floor(high)) + 1):
                d = (i - u) * nu + y * nv
                place = _place(d * scale)
                line = _LINE[place] * scale
                step = _STEP[place]
                pixels += 1
                if m == 2:
                    basis[0], basis[1] = 1.0 - step, step
                else:
                    before = 1.0
                    for q in range(m):
                        after = 0.0
                        if q + 1 < m:
                            after = step if q == inside else _STEP[_place((d - edges[q + 1]) * scale)]
                        basis[q] = before - after
                        before = after
                if g > 0:
                    basis[m] = basis[m - 1] * (d - 0.5 * reach)
                if g > 1:
                    basis[m + 1] = basis[inside] * (d + 0.5 * reach)
                basis[t], basis[t + 1] = line, -d * scale * line
                for p in range(size):
                    b = basis[p]
                    for q in range(p + 1):
                        full[p, q] += b * basis[q]
                    for k in range(3):
                        raw[p, k] += b * image[j, i, k]
                for k in range(3):
                    squares[k] += float(image[j, i, k]) ** 2
        if pixels < MIN_PIXELS:
            continue
        variance = noise * noise
        spread = 0.0
        flat, wider, own = 1e9, 0.0, 0.0
        for attempt in range(2 if g > 0 else 1):
            for i in range(t + 1):
                for j in range(i + 1):
                    matrix[i, j] = full[i, j]
                for k in range(3):
                    rhs[i, k] = raw[i, k]
                rhs[i, 3] = full[t + 1, i]
            for i in range(m):
                total = 1e-9
                for j in range(m):
                    total += full[max(i, j), min(i, j)]
                matrix[i, i] += RIDGE
                for k in range(3):
                    rhs[i, k] += RIDGE * raw[i, k] / total
            for i in range(m, t):
                matrix[i, i] += flat if attempt == 0 else variance / slope**2
            spread = _solve(matrix, rhs, t + 1)
            left = 0.0
            for k in range(3):
                left += squares[k]
                for i in range(t + 1):
                    left -= (2.0 * raw[i, k] - full[i, i] * rhs[i, k]) * rhs[i, k]
                    for j in range(i):
                        left += 2.0 * full[i, j] * rhs[i, k] * rhs[j, k]
            variance = max(noise * noise, left / (3.0 * max(pixels - t - 1.0, 1.0)))
            if attempt == 0 and m == 2:
                # What colours and shift cannot explain of a change of blur.
                own = full[t + 1, t + 1]
                total = 0.0
                for i in range(t + 1):
                    own -= full[t + 1, i] * rhs[i, 3]
                for k in range(3):
                    difference = rhs[inside, k] - rhs[inside + 1, k]
                    off = raw[t + 1, k]
                    for i in range(t + 1):
                        off -= full[t + 1, i] * rhs[i, k]
                    wider -= difference * off
                    total += difference**2
                wider /= max(total * own, 1e-9)
        # The surface inside must be the face: a finger's edge is none of the object's.
        here, there = _label(channels, table, rhs[inside]), _label(channels, table, rhs[inside + 1])
        if here != row[INSIDE] or (there != row[OUTSIDE] if row[OUTSIDE] > 0 else there == row[INSIDE]):
            continue
        contrast, shift, lift = 0.0, 0.0, 0.0
        for k in range(3):
            difference = rhs[inside, k] - rhs[inside + 1, k]
            contrast += difference**2
            shift += difference * rhs[t, k]
            lift += difference**3 / max(rhs[inside, k] + rhs[inside + 1, k], 16.0)
        if contrast < MIN_CONTRAST**2:
            continue
        out[s, OFFSET] = min(reach, max(-reach, shift / contrast))
        out[s, VARIANCE] = variance * spread / contrast
        out[s, VALID] = 1.0
        out[s, BLOOM] = 2.0 * _BLOOM * blur * lift / contrast
        if m == 2 and own > 1e-3 * full[t + 1, t + 1]:
            out[s, SHARPNESS] = contrast * own / variance
            out[s, WIDER] = wider
