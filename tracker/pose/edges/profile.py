"""How a strip's pixels depend on its edge: blurred steps between surfaces of locally constant colour."""

from __future__ import annotations

import math

import numpy as np

from tracker.compiled import compiled

_PER_UNIT = 256
_SPAN = 4.0
_X = (np.arange(int(2 * _SPAN * _PER_UNIT) + 1)) / _PER_UNIT - _SPAN
_STEP = np.array([0.5 * (1 + math.erf(x / math.sqrt(2))) for x in _X])
_LINE = np.exp(-0.5 * _X**2) / math.sqrt(2 * math.pi)


@compiled(inline="always")
def _place(z):  # type: ignore[no-untyped-def]
    """Index of z in the tables of step and line."""
    return int((min(max(z, -_SPAN), _SPAN) + _SPAN) * _PER_UNIT + 0.5)


@compiled
def surfaces(strip, seen, edges):  # type: ignore[no-untyped-def]
    """Where the edges 1 ... m - 1 between a strip's m surfaces lie [px]; returns m, and which is the face."""
    inside = 0
    if strip.reach_in < seen:
        edges[1], inside = -strip.reach_in, 1
    edges[inside + 1] = 0.0
    m = inside + 2
    if strip.reach_out < seen:
        edges[m] = strip.reach_out
        m += 1
    return m, inside


@compiled
def model(distance, shift, edges, m, inside, slopes, reach, blur, columns):  # type: ignore[no-untyped-def]
    """Columns (m + slopes + 2, P): the surfaces' shares, the line, slopes, the effect of a change of blur.

    See equation (8) of docs/how-it-works.md.
    """
    scale = 1.0 / blur
    for q in range(len(distance)):
        d = distance[q] - shift
        place = _place(d * scale)
        line = _LINE[place] * scale
        before = 1.0
        for i in range(m):
            after = 0.0
            if i + 1 < m:
                after = _STEP[place] if i == inside else _STEP[_place((d - edges[i + 1]) * scale)]
            columns[i, q] = before - after
            before = after
        columns[m, q] = line
        if slopes > 0:
            columns[m + 1, q] = columns[inside, q] * (d + 0.5 * reach)
            columns[m + 2, q] = columns[m - 1, q] * (d - 0.5 * reach)
        columns[m + slopes + 1, q] = -d * scale * line
