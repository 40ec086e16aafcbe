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
from tracker.pose.edges.profile import surfaces
from tracker.pose.edges.squares import BLUR, SHIFT, eliminate, misfit, products, substitute, widening

MIN_CONTRAST = 14.0
"""Least distance between the two surfaces' colours [levels]."""

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
    factor: FloatArray
    """(3, 8, 8) Cholesky factors of `full`, for each part."""
    half: FloatArray
    """(3, 8, 5) right sides after forward substitution: channels, blur, shift."""
    found: FloatArray
    """(3, 8, 5) solutions."""
    color: FloatArray
    """(2, 3) inside and outside."""
    edges: FloatArray
    """(5,) where the edges between the surfaces lie [px]."""


def scratch() -> Scratch:
    """New arrays."""
    return Scratch(
        np.empty((8, MAX_PIXELS)),
        np.empty((3, 8, 8)),
        np.zeros((3, 8, 3)),
        np.empty((3, 8, 8)),
        np.empty((3, 8, 5)),
        np.empty((3, 8, 5)),
        np.empty((2, 3)),
        np.empty(5),
    )


_BLOOM = math.sqrt(math.pi) / 3
"""A response of exponent γ lifts the middle of an edge by (γ - 1) · Δ²/sum · w (1 - w), with w the step and
the sum of both colours; weighted with the line, w (1 - w) is 1/6, and the line's energy 1/(2√π blur)."""


@compiled(inline="always")
def _label(palette, color):  # type: ignore[no-untyped-def]
    cell = 0
    for k in range(3):
        cell += palette.channels[k, int(min(255.0, max(0.0, color[k] + 0.5)))]
    return palette.table[cell]


@compiled(inline="always")
def _variance(squares, degrees, noise):  # type: ignore[no-untyped-def]
    """Of a pixel's channel, by what does not fit, and at least that of the noise."""
    return max(noise * noise, squares / max(degrees, 1))


@compiled
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


@compiled
def _place_edge(parts, m, inside, wide, squares, count, stiffness, reach, blur, noise, scratch, result):  # type: ignore[no-untyped-def]
    """Offset, variance and bloom of an edge: the slopes are solved for, too.

    See equation (10) of docs/how-it-works.md for offset and variance, and
    equation (12) of docs/how-it-works.md for bloom.
    """
    part = 3 // parts
    left, weight, shift, lift = squares, 0.0, 0.0, 0.0
    for g in range(parts):
        full, raw, found = scratch.full[g], scratch.raw[g], scratch.found[g]
        eliminate(full, raw, m + 1, wide, m, wide, g, part, stiffness, scratch.factor[g], scratch.half[g])
        substitute(scratch.factor[g], scratch.half[g], wide, g, part, SHIFT, found)
        left = misfit(full, raw, left, wide, found, g, g + part)
        known = 1.0 / found[m, SHIFT]
        for k in range(g, g + part):
            difference = found[inside, k] - found[inside + 1, k]
            weight += known * difference**2
            shift += known * difference * found[m, k]
            total = max(found[inside, k] + found[inside + 1, k], 16.0)
            lift += known * difference**3 / total
    weight = max(weight, MIN_CONTRAST**2 / scratch.found[0, m, SHIFT])
    result.offset = min(reach, max(-reach, shift / weight))
    result.variance = _variance(left, count - 3 * wide, noise) / weight
    result.bloom = _BLOOM * blur * lift / weight
    result.usable = True


@compiled
def _measure(strip, parts, shift, distance, values, palette, reach, blur, noise, scratch, result):  # type: ignore[no-untyped-def]
    """The offset of one strip; see `measure`."""
    part = 3 // parts
    m, inside = surfaces(strip, reach + 1.5 * blur, scratch.edges)
    slopes = 2 if strip.outside == 0 else 0
    wide = m + slopes + 1
    count, squares = 0, strip.squares
    for g in range(parts):
        products(strip, g, part, shift, distance, values, m, inside, slopes, reach, blur, scratch)
        count += strip.count[g] * part
        eliminate(
            scratch.full[g],
            scratch.raw[g],
            0,
            m + 1,
            m,
            wide,
            g,
            part,
            0.0,
            scratch.factor[g],
            scratch.half[g],
        )
        found = scratch.found[g]
        substitute(scratch.factor[g], scratch.half[g], m + 1, g, part, BLUR, found)
        for k in range(g, g + part):
            scratch.color[0, k], scratch.color[1, k] = found[inside, k], found[inside + 1, k]
    if not _is_of_face(strip, scratch.color, palette):
        return
    left, wider, sharpness = squares, 0.0, 0.0
    for g in range(parts):
        full, raw, found = scratch.full[g], scratch.raw[g], scratch.found[g]
        left = misfit(full, raw, left, m + 1, found, g, g + part)
        if m == 2:
            one, two = widening(full, raw, found, m, wide, inside, g, g + part)
            wider, sharpness = wider + one, sharpness + two
    variance = _variance(left, count - 3 * (m + 1), noise)
    if sharpness > 0.0:
        result.sharpness = sharpness / variance
        result.wider = wider / sharpness
    slope = SLOPE * min(1.0, max(1e-3, (blur - SHARP) / (SOFT - SHARP)))
    _place_edge(
        parts, m, inside, wide, squares, count, variance / slope**2, reach, blur, noise, scratch, result
    )


@compiled
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
