"""How a strip's pixels depend on its edge: blurred steps between surfaces of locally constant colour."""

from __future__ import annotations

import math

import numpy as np

from tracker.compiled import compiled
from tracker.pose.edges.pixels import BLOCK, FAR, MAX_PIXELS

BEFORE, BEYOND, INSIDE, OUTSIDE, LINE, SLOPE_IN, SLOPE_OUT, BLUR = range(8)
"""Columns of the model: the shares of the surfaces before a narrow face, beyond a narrow neighbour, of the
face and of its neighbour; the edge's line, whose factor is the shift; slopes of brightness inside and
outside; the effect of a change of blur."""

PLACES = 3 * MAX_PIXELS + 5 * BLOCK
"""Length of a column: the parts of a mosaic, and a little so that rows do not compete for the same cache."""

_PER_UNIT = 256
_SPAN = 4.0
_X = (np.arange(int(2 * _SPAN * _PER_UNIT) + 1)) / _PER_UNIT - _SPAN
_STEP = np.array([0.5 * (1 + math.erf(x / math.sqrt(2))) for x in _X])
_LINE = np.exp(-0.5 * _X**2) / math.sqrt(2 * math.pi)


@compiled(inline="always")
def _place(z):  # type: ignore[no-untyped-def]
    """Index of z in the tables of step and line; unsigned, as signed ones might count from the end."""
    return np.uint32(np.int32((min(max(z, -_SPAN), _SPAN) + _SPAN) * _PER_UNIT + 0.5))


@compiled
def model(distance, first, last, shift, slopes, reach, blur, space):  # type: ignore[no-untyped-def]
    """Fill space.columns (8, P) of an edge between two wide surfaces, but for OUTSIDE, 1 less INSIDE.

    See equation (8) of docs/how-it-works.md.
    All are zero in the gaps of FAR. slopes: whether there are.
    """
    columns, scale, half = space.columns, 1.0 / blur, 0.5 * reach
    for q in range(np.uint64(last - first)):
        away = distance[np.uint64(first) + q]
        here = 1.0 if away < FAR else 0.0
        d = (away - shift) * here
        place = _place(d * scale)
        line = _LINE[place] * scale * here
        columns[INSIDE, q] = (1.0 - _STEP[place]) * here
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
    """Fill in the surfaces behind narrow ones, and change the columns that they take their shares from."""
    columns = space.columns
    scale, half, seen = 1.0 / blur, 0.5 * reach, reach + 1.5 * blur
    for q in range(np.uint64(last - first)):
        columns[BEFORE, q], columns[BEYOND, q] = 0.0, 0.0
        if distance[np.uint64(first) + q] >= FAR:
            continue
        d = distance[np.uint64(first) + q] - shift
        if strip.reach_in < seen:
            share = 1.0 - _STEP[_place((d + strip.reach_in) * scale)]
            columns[BEFORE, q] = share
            columns[INSIDE, q] -= share
            if slopes:
                columns[SLOPE_IN, q] -= share * (d + half)
        if strip.reach_out < seen:
            share = _STEP[_place((d - strip.reach_out) * scale)]
            columns[BEYOND, q] = share
            if slopes:
                columns[SLOPE_OUT, q] = share * (d - half)
