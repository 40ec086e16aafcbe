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
from tracker.conventions import Array
from tracker.pose.edges.pixels import padded
from tracker.pose.edges.profile import PLACES, model, narrow_model
from tracker.pose.edges.solution import eliminate_surfaces, fit_colors, fit_edge
from tracker.pose.edges.squares import edge_products, narrow_products, slope_products

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


SCRATCH = np.dtype(
    [
        ("columns", np.float64, (8, PLACES)),  # of the model (`profile`)
        ("full", np.float64, (3, 8, 8)),  # products of the columns, for each part
        ("raw", np.float64, (8, 3)),  # products of the columns with the channels
        ("mean", np.float64, (4, 3)),  # of each surface's pixels
        ("color", np.float64, (2, 3)),  # inside and outside
    ]
)
"""What one strip's least squares work in; a record, since its arrays' places are known to the compiler."""


def scratch() -> Array:
    """A new one (1,)."""
    return np.zeros(1, SCRATCH)


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
def _add_up(strip, parts, shift, distance, values, reach, blur, narrow, slopes, space):  # type: ignore[no-untyped-def]
    """The products of a strip's model, for each part; the surfaces are eliminated from them."""
    part, start = 3 // parts, strip.first[0]
    end = strip.first[parts - 1] + padded(strip.count[parts - 1])
    model(distance, start, end, shift, slopes, reach, blur, space)
    if narrow:
        narrow_model(strip, distance, start, end, shift, slopes, reach, blur, space)
    for g in range(parts):
        first, count = strip.first[g] - start, strip.count[g]
        last = first + padded(count)
        edge_products(space, values, start, first, last, count, g, part)
        slope_products(space, values, start, first, last, g, part, slopes)
        if narrow:
            narrow_products(space, values, start, first, last, g, part, slopes)
        eliminate_surfaces(space, g, part, narrow, slopes)


@compiled
def _place_edge(  # type: ignore[no-untyped-def]
    parts, unknowns, narrow, slopes, squares, count, stiffness, reach, blur, noise, space, result,
):  # fmt: skip
    """Offset, variance and bloom of an edge: the slopes are solved for, too.

    See equation (10) of docs/how-it-works.md for offset and variance, and
    equation (12) of docs/how-it-works.md for bloom.
    """
    left, weight, shift, lift, certain = squares, 0.0, 0.0, 0.0, 0.0
    for g in range(parts):
        explained, known, one, two, three = fit_edge(space, g, 3 // parts, narrow, slopes, stiffness)
        left, weight, shift, lift = left - explained, weight + one, shift + two, lift + three
        if g == 0:
            certain = known
    weight = max(weight, MIN_CONTRAST**2 * certain)
    result.offset = min(reach, max(-reach, shift / weight))
    result.variance = _variance(left, count - 3 * unknowns, noise) / weight
    result.bloom = _BLOOM * blur * lift / weight
    result.usable = True


@compiled
def _measure(strip, parts, shift, distance, values, palette, reach, blur, noise, space, result):  # type: ignore[no-untyped-def]
    """The offset of one strip; see `measure`."""
    part, seen, slopes = 3 // parts, reach + 1.5 * blur, strip.outside == 0
    surfaces = 2 + int(strip.reach_in < seen) + int(strip.reach_out < seen)
    narrow = surfaces > 2
    _add_up(strip, parts, shift, distance, values, reach, blur, narrow, slopes, space)
    left, wider, sharpness, count = strip.squares, 0.0, 0.0, 0
    for g in range(parts):
        explained, one, two = fit_colors(space, g, part, narrow)
        left, wider, sharpness = left - explained, wider + one, sharpness + two
        count += strip.count[g] * part
    if not _is_of_face(strip, space.color, palette):
        return
    variance = _variance(left, count - 3 * (surfaces + 1), noise)
    if sharpness > 0.0:
        result.sharpness = sharpness / variance
        result.wider = wider / sharpness
    slope = SLOPE * min(1.0, max(1e-3, (blur - SHARP) / (SOFT - SHARP)))
    unknowns = surfaces + (3 if slopes else 1)
    _place_edge(
        parts, unknowns, narrow, slopes, strip.squares, count, variance / slope**2, reach, blur, noise,
        space, result,
    )  # fmt: skip


@compiled
def measure(strips, n, parts, motion, distance, values, palette, reach, blur, noise, every, scratch, out):  # type: ignore[no-untyped-def]
    """Offsets of n strips: out (n,) of OFFSET.

    parts: 3 where each pixel of a mosaic counts for one channel, else 1: channels that were measured at the
    same pixels are solved together, the parts share the shift alone; motion (6,): of the pose since the
    strips were collected [m, rad]; distance (P,), values (3, P): their pixels; reach: half width of the
    strips [px]; blur: standard deviation of the steps [px]; noise: least of a pixel's channel [levels];
    every: one in so many strips is looked at; scratch (1,): of SCRATCH.
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
        _measure(strip, parts, shift, distance, values, palette, reach, blur, noise, scratch[0], result)
