"""Products of the columns of one strip's model with each other and with its pixels' channels.

Several of them from one loop, since strips have few pixels and the ends of loops cost. The surfaces' shares
sum to 1: products with the share outside follow from sums. Indices are unsigned, as signed ones might count
from the end, which would keep the compiler from loading neighbours at once.
"""

from __future__ import annotations

import numpy as np

from tracker.compiled import compiled
from tracker.pose.edges.pixels import SUMS
from tracker.pose.edges.profile import BEFORE, BEYOND, BLUR, INSIDE, LINE, OUTSIDE, SLOPE_IN, SLOPE_OUT

RIDGE = 0.003
"""Weight of a surface's prior colour, the mean of its pixels, against one pixel."""


@compiled(fastmath=SUMS)
def _edge(space, values, k, at, first, last):  # type: ignore[no-untyped-def]
    """Sums of share a inside, line e and blur w, and their products with each other and with a channel v."""
    columns = space.columns
    a, e, w, aa, ae, aw, ee, ew, ww = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    v, av, ev, wv = 0.0, 0.0, 0.0, 0.0
    for q in range(np.uint64(first), np.uint64(last)):
        inside, line, blur = columns[INSIDE, q], columns[LINE, q], columns[BLUR, q]
        value = values[k, np.uint64(at) + q]
        a += inside
        e += line
        w += blur
        v += value
        aa += inside * inside
        ae += inside * line
        aw += inside * blur
        av += inside * value
        ee += line * line
        ew += line * blur
        ev += line * value
        ww += blur * blur
        wv += blur * value
    return a, e, w, aa, ae, aw, ee, ew, ww, v, av, ev, wv


@compiled(fastmath=SUMS)
def _edge_channel(space, values, k, at, first, last):  # type: ignore[no-untyped-def]
    """As above, what concerns a further channel."""
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
def _slopes(space, values, k, at, first, last):  # type: ignore[no-untyped-def]
    """Sums of the slopes i inside and o outside, their products with each other, the edge and a channel."""
    columns = space.columns
    i, o, ai, ao, ei, eo = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    ii, io, oo, iv, ov = 0.0, 0.0, 0.0, 0.0, 0.0
    for q in range(np.uint64(first), np.uint64(last)):
        inner, outer = columns[SLOPE_IN, q], columns[SLOPE_OUT, q]
        inside, line, value = columns[INSIDE, q], columns[LINE, q], values[k, np.uint64(at) + q]
        i += inner
        o += outer
        ai += inside * inner
        ao += inside * outer
        ei += line * inner
        eo += line * outer
        ii += inner * inner
        io += inner * outer
        oo += outer * outer
        iv += inner * value
        ov += outer * value
    return i, o, ai, ao, ei, eo, ii, io, oo, iv, ov


@compiled(fastmath=SUMS)
def _dot(space, i, values, k, at, first, last):  # type: ignore[no-untyped-def]
    """Sum of products of column i and row k of values."""
    columns, total = space.columns, 0.0
    for q in range(np.uint64(first), np.uint64(last)):
        total += columns[i, q] * values[k, np.uint64(at) + q]
    return total


@compiled(inline="always")
def _fill_channel(raw, mean, k, area, rest, v, av, ev, wv):  # type: ignore[no-untyped-def]
    """The products with channel k; the surfaces' are drawn a little to the mean of their pixels."""
    inside, outside = av / (area + 1e-9), (v - av) / (rest + 1e-9)
    mean[INSIDE, k], mean[OUTSIDE, k] = inside, outside
    raw[INSIDE, k], raw[OUTSIDE, k] = av + RIDGE * inside, v - av + RIDGE * outside
    raw[LINE, k], raw[BLUR, k] = ev, wv


@compiled
def edge_products(space, values, start, first, last, count, g, part):  # type: ignore[no-untyped-def]
    """Fill space.full[g] and .raw, of `part` channels from g on, with those of two surfaces, line and blur.

    Places first … last - 1 of the columns belong to the values from start + first on; `count` are no gaps.
    """
    full, raw, mean = space.full, space.raw, space.mean
    a, e, w, aa, ae, aw, ee, ew, ww, v, av, ev, wv = _edge(space, values, g, start, first, last)
    full[g, INSIDE, INSIDE], full[g, INSIDE, OUTSIDE] = aa + RIDGE, a - aa
    full[g, INSIDE, LINE], full[g, INSIDE, BLUR] = ae, aw
    full[g, OUTSIDE, OUTSIDE] = count - 2.0 * a + aa + RIDGE
    full[g, OUTSIDE, LINE], full[g, OUTSIDE, BLUR] = e - ae, w - aw
    full[g, LINE, LINE], full[g, LINE, BLUR], full[g, BLUR, BLUR] = ee, ew, ww
    _fill_channel(raw, mean, g, a, count - a, v, av, ev, wv)
    for k in range(g + 1, g + part):
        v, av, ev, wv = _edge_channel(space, values, k, start, first, last)
        _fill_channel(raw, mean, k, a, count - a, v, av, ev, wv)


@compiled
def slope_products(space, values, start, first, last, g, part, slopes):  # type: ignore[no-untyped-def]
    """Fill in those of the slopes: zero where there are none."""
    full, raw = space.full, space.raw
    if not slopes:
        full[g, INSIDE, SLOPE_IN], full[g, INSIDE, SLOPE_OUT] = 0.0, 0.0
        full[g, OUTSIDE, SLOPE_IN], full[g, OUTSIDE, SLOPE_OUT] = 0.0, 0.0
        full[g, LINE, SLOPE_IN], full[g, LINE, SLOPE_OUT] = 0.0, 0.0
        return
    i, o, ai, ao, ei, eo, ii, io, oo, iv, ov = _slopes(space, values, g, start, first, last)
    full[g, INSIDE, SLOPE_IN], full[g, INSIDE, SLOPE_OUT] = ai, ao
    full[g, OUTSIDE, SLOPE_IN], full[g, OUTSIDE, SLOPE_OUT] = i - ai, o - ao
    full[g, LINE, SLOPE_IN], full[g, LINE, SLOPE_OUT] = ei, eo
    full[g, SLOPE_IN, SLOPE_IN], full[g, SLOPE_IN, SLOPE_OUT], full[g, SLOPE_OUT, SLOPE_OUT] = ii, io, oo
    raw[SLOPE_IN, g], raw[SLOPE_OUT, g] = iv, ov
    for k in range(g + 1, g + part):
        raw[SLOPE_IN, k] = _dot(space, SLOPE_IN, values, k, start, first, last)
        raw[SLOPE_OUT, k] = _dot(space, SLOPE_OUT, values, k, start, first, last)


@compiled
def narrow_products(space, values, start, first, last, g, part, slopes):  # type: ignore[no-untyped-def]
    """Fill in those of the surfaces behind narrow ones, and change those of the share outside."""
    columns, full, raw, mean = space.columns, space.full, space.raw, space.mean
    # What the products above took for that share: all but the share inside.
    rest = full[g, OUTSIDE, OUTSIDE] + full[g, INSIDE, OUTSIDE] - RIDGE
    full[g, BEFORE, BEYOND] = _dot(space, BEFORE, space.columns, BEYOND, 0, first, last)
    for i in (BEFORE, BEYOND):
        area, square = 0.0, _dot(space, i, space.columns, i, 0, first, last)
        for q in range(first, last):
            area += columns[i, q]
        for j in (INSIDE, LINE, SLOPE_IN, SLOPE_OUT, BLUR):
            stale = not slopes and j in (SLOPE_IN, SLOPE_OUT)
            full[g, i, j] = 0.0 if stale else _dot(space, i, space.columns, j, 0, first, last)
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
