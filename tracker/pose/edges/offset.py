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
from typing import NamedTuple

import numpy as np

from tracker.compiled import compiled
from tracker.conventions import Array, FloatArray
from tracker.pose.edges.pixels import MAX_PIXELS
from tracker.pose.edges.profile import model, surfaces

MIN_CONTRAST = 14.0
"""Least distance between the two surfaces' colours [levels]."""

RIDGE = 0.003
"""Weight of a surface's prior colour, the mean of its pixels, against one pixel."""

SLOPE = 2.0
"""Standard deviation of a surface's slope of brightness across a silhouette [levels/px]: shading, shadows."""

SHARP, SOFT = 0.3, 0.7
"""Blur [px] at which a picture is drawn rather than taken, so that surfaces are flat; and from which on they
are not. What is left over at a drawn edge is sampling, which slopes must not explain."""

MIN_PIXELS = 8
"""Pixels of a piece of an edge below which nothing is measured."""

OFFSET = np.dtype(
    [
        ("offset", np.float64),  # of the edge from where it was expected, along the normal [px]
        ("variance", np.float64),  # of that, from noise [px²]
        ("bloom", np.float64),  # the offset that a response of exponent 2 instead of 1 would feign [px]
        ("wider", np.float64),  # by how much the edge looks wider than the blur [px], …
        ("sharpness", np.float64),  # … and the weight of that; 0: it cannot tell
        ("usable", np.bool_),  # whether there is an offset
    ]
)
"""What a strip of pixels says of its edge."""


class Palette(NamedTuple):
    """How the colours of a picture are read."""

    channels: Array
    """(3, 256) int32: offsets into the table of each level."""
    table: Array
    """(64³,) uint8: the label of each colour cell."""


class Scratch(NamedTuple):
    """Arrays that one strip's least squares work in."""

    columns: FloatArray
    """(8, MAX_PIXELS) of the model."""
    full: FloatArray
    """(3, 8, 8) products of the columns, for each part."""
    raw: FloatArray
    """(3, 8, 3) products of the columns with the channels."""
    found: FloatArray
    """(3, 8, 4) solutions for the channels and for an extra column."""
    factor: FloatArray
    """(8, 8)"""
    color: FloatArray
    """(2, 3) inside and outside."""
    unit: FloatArray
    """(8,) zeros"""
    edges: FloatArray
    """(5,) where the edges between the surfaces lie [px]."""


def scratch() -> Scratch:
    """New arrays."""
    return Scratch(
        np.empty((8, MAX_PIXELS)),
        np.empty((3, 8, 8)),
        np.zeros((3, 8, 3)),
        np.empty((3, 8, 4)),
        np.empty((8, 8)),
        np.empty((2, 3)),
        np.zeros(8),
        np.empty(5),
    )


_BLOOM = math.sqrt(math.pi) / 3
"""A response of exponent γ lifts the middle of an edge by (γ - 1) · Δ²/sum · w (1 - w), with w the step and
the sum of both colours; weighted with the line, w (1 - w) is 1/6, and the line's energy 1/(2√π blur)."""


@compiled(fastmath=True)
def _dot(a, b, n):  # type: ignore[no-untyped-def]
    """Sum of products of the first n; in whatever order is fastest, but always in the same."""
    total = 0.0
    for i in range(n):
        total += a[i] * b[i]
    return total


@compiled(error_model="numpy")
def _solve(full, raw, extra, m, size, stiffness, factor, out):  # type: ignore[no-untyped-def]
    """Out (size, 4): least squares of the colours' three channels raw (·, 3), and of the column `extra`.

    full: the columns' products, lower half. The first m unknowns, surfaces' colours, are drawn a little to
    the mean of their pixels, those after the line (m) to zero with `stiffness`.
    """
    for i in range(size):
        for j in range(i + 1):
            factor[i, j] = full[i, j]
        for k in range(3):
            out[i, k] = raw[i, k]
        out[i, 3] = extra[i]
        if i < m:
            total = 1e-9
            for j in range(m):
                total += full[max(i, j), min(i, j)]
            factor[i, i] += RIDGE
            for k in range(3):
                out[i, k] += RIDGE * raw[i, k] / total
        elif i > m:
            factor[i, i] += stiffness
    for i in range(size):
        for j in range(i):
            for k in range(j):
                factor[i, j] -= factor[i, k] * factor[j, k]
            factor[i, j] *= factor[j, j]
        for k in range(i):
            factor[i, i] -= factor[i, k] ** 2
        # The diagonal holds reciprocals.
        factor[i, i] = 1.0 / math.sqrt(max(factor[i, i], 1e-9))
    for i in range(size):
        for k in range(i):
            for ch in range(4):
                out[i, ch] -= factor[i, k] * out[k, ch]
        for ch in range(4):
            out[i, ch] *= factor[i, i]
    for i in range(size - 1, -1, -1):
        for k in range(i + 1, size):
            for ch in range(4):
                out[i, ch] -= factor[k, i] * out[k, ch]
        for ch in range(4):
            out[i, ch] *= factor[i, i]


@compiled(error_model="numpy")
def _misfit(full, raw, squares, size, found, first, last):  # type: ignore[no-untyped-def]
    """Sum of squared residuals over pixels and channels; squares: sum of the values' squares."""
    total = squares
    for k in range(first, last):
        for i in range(size):
            product = 0.5 * full[i, i] * found[i, k] - raw[i, k]
            for j in range(i):
                product += full[i, j] * found[j, k]
            total += 2.0 * product * found[i, k]
    return total


@compiled(inline="always")
def _label(palette, color):  # type: ignore[no-untyped-def]
    cell = 0
    for k in range(3):
        cell += palette.channels[k, int(min(255.0, max(0.0, color[k] + 0.5)))]
    return palette.table[cell]


@compiled(inline="always")
def _variance(misfit, degrees, noise):  # type: ignore[no-untyped-def]
    """Of a pixel's channel, by what does not fit, and at least that of the noise."""
    return max(noise * noise, misfit / max(degrees, 1))


@compiled(error_model="numpy")
def _blurred(full, raw, found, m, wide, inside, first, last):  # type: ignore[no-untyped-def]
    """What speaks for a change of blur that colours and shift cannot explain, and how much could."""
    own, wider, contrast = full[wide, wide], 0.0, 0.0
    for i in range(m + 1):
        own -= full[wide, i] * found[i, 3]
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


@compiled(error_model="numpy")
def _products(strip, g, part, shift, distance, values, m, inside, slopes, reach, blur, scratch):  # type: ignore[no-untyped-def]
    """Products of the columns with each other and with `part` channels from g on; returns Σ values²."""
    first, last = strip.first[g], strip.first[g] + strip.count[g]
    columns, full, raw, pixels = scratch.columns, scratch.full[g], scratch.raw[g], last - first
    model(distance[first:last], shift, scratch.edges, m, inside, slopes, reach, blur, columns)
    for i in range(m + slopes + 2):
        for j in range(i + 1):
            full[i, j] = _dot(columns[i], columns[j], pixels)
        for k in range(g, g + part):
            raw[i, k] = _dot(columns[i], values[k, first:last], pixels)
    squares = 0.0
    for k in range(g, g + part):
        squares += _dot(values[k, first:last], values[k, first:last], pixels)
    return squares


@compiled(error_model="numpy")
def _is_of_face(strip, color, palette):  # type: ignore[no-untyped-def]
    """Whether the colours (2, 3) inside and outside are the face's and none of it, and differ enough."""
    # The surface inside must be the face: a finger's edge is none of the object's.
    here, there = _label(palette, color[0]), _label(palette, color[1])
    if here != strip.inside or (there != strip.outside if strip.outside > 0 else there == strip.inside):
        return False
    contrast = 0.0
    for k in range(3):
        contrast += (color[0, k] - color[1, k]) ** 2
    return contrast >= MIN_CONTRAST**2


@compiled(error_model="numpy")
def _place_edge(  # type: ignore[no-untyped-def]
    parts, m, inside, wide, squares, count, stiffness, reach, blur, noise, scratch, result,
):  # fmt: skip
    """Offset, variance and bloom of an edge, from the products of its strip."""
    part = 3 // parts
    scratch.unit[m] = 1.0
    misfit, weight, shift, lift = squares, 0.0, 0.0, 0.0
    for g in range(parts):
        found = scratch.found[g]
        _solve(scratch.full[g], scratch.raw[g], scratch.unit, m, wide, stiffness, scratch.factor, found)
        misfit = _misfit(scratch.full[g], scratch.raw[g], misfit, wide, found, g, g + part)
        known = 1.0 / found[m, 3]
        for k in range(g, g + part):
            difference = found[inside, k] - found[inside + 1, k]
            weight += known * difference**2
            shift += known * difference * found[m, k]
            total = max(found[inside, k] + found[inside + 1, k], 16.0)
            lift += known * difference**3 / total
    scratch.unit[m] = 0.0
    weight = max(weight, MIN_CONTRAST**2 / scratch.found[0, m, 3])
    result.offset = min(reach, max(-reach, shift / weight))
    result.variance = _variance(misfit, count - 3 * wide, noise) / weight
    result.bloom = _BLOOM * blur * lift / weight
    result.usable = True


@compiled(error_model="numpy")
def _measure(strip, parts, shift, distance, values, palette, reach, blur, noise, scratch, result):  # type: ignore[no-untyped-def]
    """The offset of one strip; see `measure`."""
    part = 3 // parts
    m, inside = surfaces(strip, reach + 1.5 * blur, scratch.edges)
    slopes = 2 if strip.outside == 0 else 0
    wide = m + slopes + 1
    count, squares = 0, 0.0
    for g in range(parts):
        squares += _products(strip, g, part, shift, distance, values, m, inside, slopes, reach, blur, scratch)
        count += strip.count[g] * part
    for g in range(parts):
        found = scratch.found[g]
        _solve(scratch.full[g], scratch.raw[g], scratch.full[g, wide], m, m + 1, 0.0, scratch.factor, found)
        for k in range(g, g + part):
            scratch.color[0, k], scratch.color[1, k] = found[inside, k], found[inside + 1, k]
    if not _is_of_face(strip, scratch.color, palette):
        return
    misfit, wider, sharpness = squares, 0.0, 0.0
    for g in range(parts):
        found = scratch.found[g]
        misfit = _misfit(scratch.full[g], scratch.raw[g], misfit, m + 1, found, g, g + part)
        if m == 2:
            one, two = _blurred(scratch.full[g], scratch.raw[g], found, m, wide, inside, g, g + part)
            wider, sharpness = wider + one, sharpness + two
    variance = _variance(misfit, count - 3 * (m + 1), noise)
    if sharpness > 0.0:
        result.sharpness = sharpness / variance
        result.wider = wider / sharpness
    slope = SLOPE * min(1.0, max(1e-3, (blur - SHARP) / (SOFT - SHARP)))
    _place_edge(
        parts, m, inside, wide, squares, count, variance / slope**2, reach, blur, noise, scratch, result,
    )  # fmt: skip


@compiled(error_model="numpy")
def measure(strips, n, parts, motion, distance, values, palette, reach, blur, noise, every, scratch, out):  # type: ignore[no-untyped-def]
    """Offsets of n strips: out (n,) of OFFSET.

    parts: 3 where each pixel of a mosaic counts for one channel, else 1: channels that were measured at the
    same pixels are solved together, the parts share the shift alone; motion (6,): of the pose since the
    strips were collected [m, rad]; distance (P,), values (3, P): their pixels; reach: half width of the
    strips [px]; blur: standard deviation of the steps [px]; noise: least of a pixel's channel [levels];
    every: one in so many strips is looked at.
    """
    for s in range(n):
        strip, result = strips[s], out[s]
        result.usable, result.sharpness = False, 0.0
        pixels = strip.count[0] + strip.count[1] + strip.count[2]
        if s % every or pixels < (3 * MIN_PIXELS // parts if parts > 1 else MIN_PIXELS):
            continue
        shift = 0.0
        for i in range(6):
            shift += strip.jacobian[i] * motion[i]
        _measure(strip, parts, shift, distance, values, palette, reach, blur, noise, scratch, result)
