"""The model of an image near an edge: the columns of a linear least-squares problem, and their products."""

import math

import numpy as np

from tracker.compiled import compiled
from tracker.pose.strips import BLOCK, FAR, MAX_PIXELS, SUMS

RIDGE = 0.003
"""Weight of a surface's prior colour, the mean of its pixels, relative to one pixel."""

BEFORE, BEYOND, INSIDE, OUTSIDE, LINE, SLOPE_IN, SLOPE_OUT, BLUR = range(8)
"""Columns of the model: the shares of the surface in front of a narrow face, of that beyond a narrow
neighbour, of the face and of its neighbour; the edge's line profile, whose coefficient gives the shift;
gradients inside and outside; the effect of a change of blur."""

PLACES = 3 * MAX_PIXELS + 5 * BLOCK
"""Length of a column: the parts of a mosaic, padded so that rows do not share cache sets."""

SCRATCH = np.dtype(
    [
        ("columns", np.float64, (8, PLACES)),  # of the model (`model`)
        ("full", np.float64, (3, 8, 8)),  # products of the columns, for each part
        ("raw", np.float64, (8, 3)),  # products of the columns with the channels
        ("mean", np.float64, (4, 3)),  # of each surface's pixels
        ("color", np.float64, (2, 3)),  # inside and outside
    ]
)
"""Workspace for one strip's least squares; a record, so that the compiler knows its memory layout."""

_PER_UNIT = 256
_SPAN = 4.0
_X = (np.arange(int(2 * _SPAN * _PER_UNIT) + 1)) / _PER_UNIT - _SPAN
_STEPS = np.array([0.5 * (1 + math.erf(x / math.sqrt(2))) for x in _X])
_LINE = np.exp(-0.5 * _X**2) / math.sqrt(2 * math.pi)


@compiled
def _table_index(z):  # type: ignore[no-untyped-def]
    """Index of z in the tables of step and line; unsigned, since a signed index could count from the end."""
    return np.uint32(np.int32((min(max(z, -_SPAN), _SPAN) + _SPAN) * _PER_UNIT + 0.5))


@compiled
def model(distance, first, last, shift, slopes, reach, blur, space):  # type: ignore[no-untyped-def]
    """Fill space.columns (8, P) for an edge between two wide surfaces, except OUTSIDE, which is 1 - INSIDE.

    See equation (8) of docs/how-it-works.md.
    The columns are zero in the gaps (FAR). slopes: whether the model has gradients.
    """
    columns, scale, half = space.columns, 1.0 / blur, 0.5 * reach
    for q in range(np.uint64(last - first)):
        away = distance[np.uint64(first) + q]
        here = 1.0 if away < FAR else 0.0
        d = (away - shift) * here
        place = _table_index(d * scale)
        line = _LINE[place] * scale * here
        columns[INSIDE, q] = (1.0 - _STEPS[place]) * here
        columns[LINE, q] = line
        columns[BLUR, q] = -d * scale * line
    if slopes:
        for q in range(np.uint64(last - first)):
            away = distance[np.uint64(first) + q]
            here = 1.0 if away < FAR else 0.0
            d = (away - shift) * here
            columns[SLOPE_IN, q] = columns[INSIDE, q] * (d + half)
            columns[SLOPE_OUT, q] = (here - columns[INSIDE, q]) * (d - half)


@compiled
def narrow_model(strip, distance, first, last, shift, slopes, reach, blur, space):  # type: ignore[no-untyped-def]
    """Fill the columns of surfaces behind narrow ones, and subtract these from the columns they overlap."""
    columns = space.columns
    scale, half, seen = 1.0 / blur, 0.5 * reach, reach + 1.5 * blur
    for q in range(np.uint64(last - first)):
        columns[BEFORE, q], columns[BEYOND, q] = 0.0, 0.0
        if distance[np.uint64(first) + q] >= FAR:
            continue
        d = distance[np.uint64(first) + q] - shift
        if strip.reach_in < seen:
            share = 1.0 - _STEPS[_table_index((d + strip.reach_in) * scale)]
            columns[BEFORE, q] = share
            columns[INSIDE, q] -= share
            if slopes:
                columns[SLOPE_IN, q] -= share * (d + half)
        if strip.reach_out < seen:
            columns[BEYOND, q] = _STEPS[_table_index((d - strip.reach_out) * scale)]


@compiled(fastmath=SUMS)
def _edge(space, first, last):  # type: ignore[no-untyped-def]
    """Sums of share a inside, line e and blur w, and their products with each other."""
    columns = space.columns
    a, e, w, aa, ae, aw, ee, ew, ww = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for q in range(np.uint64(first), np.uint64(last)):
        inside, line, blur = columns[INSIDE, q], columns[LINE, q], columns[BLUR, q]
        a += inside
        e += line
        w += blur
        aa += inside * inside
        ae += inside * line
        aw += inside * blur
        ee += line * line
        ew += line * blur
        ww += blur * blur
    return a, e, w, aa, ae, aw, ee, ew, ww


@compiled(fastmath=SUMS)
def _slope_sums(space, first, last):  # type: ignore[no-untyped-def]
    """Sums of gradients i inside and o outside, and their products with each other, share and line."""
    columns = space.columns
    i, o, ai, ao, ei, eo, ii, io, oo = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for q in range(np.uint64(first), np.uint64(last)):
        inner, outer = columns[SLOPE_IN, q], columns[SLOPE_OUT, q]
        inside, line = columns[INSIDE, q], columns[LINE, q]
        i += inner
        o += outer
        ai += inside * inner
        ao += inside * outer
        ei += line * inner
        eo += line * outer
        ii += inner * inner
        io += inner * outer
        oo += outer * outer
    return i, o, ai, ao, ei, eo, ii, io, oo


@compiled(fastmath=SUMS)
def _channel(space, values, k, at, first, last):  # type: ignore[no-untyped-def]
    """Sum of a channel v, and its products with share inside, line, blur."""
    columns = space.columns
    v, av, ev, wv = 0.0, 0.0, 0.0, 0.0
    for q in range(np.uint64(first), np.uint64(last)):
        value = values[k, np.uint64(at) + q]
        v += value
        av += columns[INSIDE, q] * value
        ev += columns[LINE, q] * value
        wv += columns[BLUR, q] * value
    return v, av, ev, wv


@compiled(fastmath=SUMS)
def _dot(space, i, values, k, at, first, last):  # type: ignore[no-untyped-def]
    """Dot product of column i and row k of values."""
    columns, total = space.columns, 0.0
    for q in range(np.uint64(first), np.uint64(last)):
        total += columns[i, q] * values[k, np.uint64(at) + q]
    return total


@compiled
def edge_products(space, values, start, first, last, count, g, part, slopes):  # type: ignore[no-untyped-def]
    """Fill space.full[g] and .raw, for `part` channels from g on: two surfaces, line, blur and gradients.

    Entries first … last - 1 of the columns belong to the values from start + first on; `count` are pixels.
    Without slopes, the products with the gradients are zero.
    """
    full, raw, mean = space.full, space.raw, space.mean
    a, e, w, aa, ae, aw, ee, ew, ww = _edge(space, first, last)
    full[g, INSIDE, INSIDE], full[g, INSIDE, OUTSIDE] = aa + RIDGE, a - aa
    full[g, INSIDE, LINE], full[g, INSIDE, BLUR] = ae, aw
    full[g, OUTSIDE, OUTSIDE] = count - 2.0 * a + aa + RIDGE
    full[g, OUTSIDE, LINE], full[g, OUTSIDE, BLUR] = e - ae, w - aw
    full[g, LINE, LINE], full[g, LINE, BLUR], full[g, BLUR, BLUR] = ee, ew, ww
    i, o, ai, ao, ei, eo, ii, io, oo = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    if slopes:
        i, o, ai, ao, ei, eo, ii, io, oo = _slope_sums(space, first, last)
    full[g, INSIDE, SLOPE_IN], full[g, INSIDE, SLOPE_OUT] = ai, ao
    full[g, OUTSIDE, SLOPE_IN], full[g, OUTSIDE, SLOPE_OUT] = i - ai, o - ao
    full[g, LINE, SLOPE_IN], full[g, LINE, SLOPE_OUT] = ei, eo
    full[g, SLOPE_IN, SLOPE_IN], full[g, SLOPE_IN, SLOPE_OUT], full[g, SLOPE_OUT, SLOPE_OUT] = ii, io, oo
    for k in range(g, g + part):
        v, av, ev, wv = _channel(space, values, k, start, first, last)
        if slopes:
            raw[SLOPE_IN, k] = _dot(space, SLOPE_IN, values, k, start, first, last)
            raw[SLOPE_OUT, k] = _dot(space, SLOPE_OUT, values, k, start, first, last)
        # RIDGE pulls each surface's colour slightly to its pixels' mean.
        mean[INSIDE, k], mean[OUTSIDE, k] = av / (a + 1e-9), (v - av) / (count - a + 1e-9)
        raw[INSIDE, k], raw[OUTSIDE, k] = av + RIDGE * mean[INSIDE, k], v - av + RIDGE * mean[OUTSIDE, k]
        raw[LINE, k], raw[BLUR, k] = ev, wv


@compiled
def narrow_products(space, values, start, first, last, g, part):  # type: ignore[no-untyped-def]
    """Fill the products of surfaces behind narrow ones, and correct those of the share outside."""
    columns, full, raw, mean = space.columns, space.full, space.raw, space.mean
    # The total share outside in the products above: all but the share inside.
    rest = full[g, OUTSIDE, OUTSIDE] + full[g, INSIDE, OUTSIDE] - RIDGE
    full[g, BEFORE, BEYOND] = _dot(space, BEFORE, space.columns, BEYOND, 0, first, last)
    for i in (BEFORE, BEYOND):
        area, square = 0.0, _dot(space, i, space.columns, i, 0, first, last)
        for q in range(first, last):
            area += columns[i, q]
        for j in (INSIDE, LINE, SLOPE_IN, SLOPE_OUT, BLUR):
            full[g, i, j] = _dot(space, i, space.columns, j, 0, first, last)
            full[g, min(OUTSIDE, j), max(OUTSIDE, j)] -= full[g, i, j]
        full[g, i, i] = square + RIDGE
        full[g, i, OUTSIDE] = area - square - full[g, BEFORE, BEYOND] - full[g, i, INSIDE]
        rest -= area
        for k in range(g, g + part):
            product = _dot(space, i, values, k, start, first, last)
            mean[i, k] = product / (area + 1e-9)
            raw[i, k] = product + RIDGE * mean[i, k]
            raw[OUTSIDE, k] -= product
    for k in range(g, g + part):
        product = raw[OUTSIDE, k] - RIDGE * mean[OUTSIDE, k]
        mean[OUTSIDE, k] = product / (rest + 1e-9)
        raw[OUTSIDE, k] = product + RIDGE * mean[OUTSIDE, k]
    others = full[g, INSIDE, OUTSIDE] + full[g, BEFORE, OUTSIDE] + full[g, BEYOND, OUTSIDE]
    full[g, OUTSIDE, OUTSIDE] = rest - others + RIDGE
