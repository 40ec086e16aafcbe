"""The solution of one strip's least squares: the surfaces' colours, then the edge's place.

Solved without the slopes first, which tells the noise and with it how stiff the slopes are; both share the
elimination of the surfaces. Of a matrix the upper triangle counts; the row of an unknown that has been
eliminated stays for the substitution, with the reciprocal of its pivot on the diagonal. A fit to channel k
reduces the sum of squares by products of right sides and pivots, less what the priors are paid.
"""

from __future__ import annotations

from tracker.compiled import compiled
from tracker.pose.edges.profile import BEFORE, BEYOND, BLUR, INSIDE, LINE, OUTSIDE, SLOPE_IN, SLOPE_OUT
from tracker.pose.edges.squares import RIDGE

LEAST = 1e-9
"""Of a pivot."""


@compiled
def eliminate_surfaces(space, g, part, narrow, slopes):  # type: ignore[no-untyped-def]
    """Eliminate the surfaces' colours from space.full[g] and .raw, of `part` channels from g on.

    But for BLUR's own row: how others depend on it is all that is asked.
    """
    full, raw = space.full, space.raw
    last = SLOPE_OUT + 1 if slopes else LINE + 1
    for i in range(BEFORE if narrow else INSIDE, OUTSIDE + 1):
        pivot = 1.0 / max(full[g, i, i], LEAST)
        full[g, i, i] = pivot
        for j in range(i + 1, last):
            factor = full[g, i, j] * pivot
            for k in range(j, BLUR + 1):
                full[g, j, k] -= factor * full[g, i, k]
            for k in range(g, g + part):
                raw[j, k] -= factor * raw[i, k]


@compiled(inline="always")
def _explained(full, raw, mean, g, k, i, x):  # type: ignore[no-untyped-def]
    """By how much a surface of colour x reduces the sum of squares."""
    return raw[i, k] ** 2 * full[g, i, i] + RIDGE * x * (x - 2.0 * mean[i, k])


@compiled
def _explained_behind(space, g, k, inside, outside, line, inner, outer):  # type: ignore[no-untyped-def]
    """By how much surfaces behind narrow ones do, given the other unknowns."""
    full, raw, mean, total, beyond = space.full, space.raw, space.mean, 0.0, 0.0
    for i in (BEYOND, BEFORE):
        x = raw[i, k] - full[g, i, INSIDE] * inside - full[g, i, OUTSIDE] * outside - full[g, i, LINE] * line
        x -= full[g, i, SLOPE_IN] * inner + full[g, i, SLOPE_OUT] * outer
        if i == BEFORE:
            x -= full[g, BEFORE, BEYOND] * beyond
        x *= full[g, i, i]
        beyond = x
        total += _explained(full, raw, mean, g, k, i, x)
    return total


@compiled
def fit_colors(space, g, part, narrow):  # type: ignore[no-untyped-def]
    """Fill space.color with those inside and outside, solved for without slopes.

    See equation (11) of docs/how-it-works.md for the blur.
    Returns by how much they and the shift reduce the sum of squares, what speaks for a change of blur that
    they cannot explain, and how much could; of narrow surfaces nothing.
    """
    full, raw, mean = space.full, space.raw, space.mean
    a, b, e = full[g, INSIDE, INSIDE], full[g, OUTSIDE, OUTSIDE], 1.0 / max(full[g, LINE, LINE], LEAST)
    aw, bw, ew = full[g, INSIDE, BLUR], full[g, OUTSIDE, BLUR], full[g, LINE, BLUR]
    own = full[g, BLUR, BLUR] - aw * aw * a - bw * bw * b - ew * ew * e
    total, wider, contrast = 0.0, 0.0, 0.0
    for k in range(g, g + part):
        line = raw[LINE, k] * e
        outside = (raw[OUTSIDE, k] - full[g, OUTSIDE, LINE] * line) * b
        inside = (raw[INSIDE, k] - full[g, INSIDE, OUTSIDE] * outside - full[g, INSIDE, LINE] * line) * a
        space.color[0, k], space.color[1, k] = inside, outside
        total += raw[LINE, k] * line
        total += _explained(full, raw, mean, g, k, INSIDE, inside)
        total += _explained(full, raw, mean, g, k, OUTSIDE, outside)
        if narrow:
            total += _explained_behind(space, g, k, inside, outside, line, 0.0, 0.0)
        off = raw[BLUR, k] - aw * a * raw[INSIDE, k] - bw * b * raw[OUTSIDE, k] - ew * line
        wider -= (inside - outside) * off
        contrast += (inside - outside) ** 2
    if narrow or own <= 1e-3 * full[g, BLUR, BLUR]:
        return total, 0.0, 0.0
    return total, wider, contrast * own


@compiled
def fit_edge(space, g, part, narrow, slopes, stiffness):  # type: ignore[no-untyped-def]
    """The edge's shift, solved for with the slopes, which are drawn to zero with `stiffness`.

    This is equation (9) of docs/how-it-works.md.
    Returns by how much all unknowns reduce the sum of squares, how well the shift of a contrast of 1 is
    known, and sums over channels: of the weight, of the shift and of the lift by a response, both weighted.
    """
    full, raw, mean = space.full, space.raw, space.mean
    known, i, o, io, ei, eo = full[g, LINE, LINE], 0.0, 0.0, 0.0, 0.0, 0.0
    if slopes:
        i = 1.0 / max(full[g, SLOPE_IN, SLOPE_IN] + stiffness, LEAST)
        io = full[g, SLOPE_IN, SLOPE_OUT]
        o = 1.0 / max(full[g, SLOPE_OUT, SLOPE_OUT] + stiffness - io * io * i, LEAST)
        ei = full[g, LINE, SLOPE_IN]
        eo = full[g, LINE, SLOPE_OUT] - ei * io * i
        known -= ei * ei * i + eo * eo * o
    known = max(known, LEAST)
    total, weight, shift, lift = 0.0, 0.0, 0.0, 0.0
    for k in range(g, g + part):
        line, inner, outer = raw[LINE, k], 0.0, 0.0
        if slopes:
            one, two = raw[SLOPE_IN, k], raw[SLOPE_OUT, k] - io * i * raw[SLOPE_IN, k]
            line = (line - ei * i * one - eo * o * two) / known
            outer = (two - eo * line) * o
            inner = (one - io * outer - ei * line) * i
            total += one * one * i + two * two * o + stiffness * (inner * inner + outer * outer)
        else:
            line /= known
        total += line * line * known
        outside = raw[OUTSIDE, k] - full[g, OUTSIDE, LINE] * line
        outside -= full[g, OUTSIDE, SLOPE_IN] * inner + full[g, OUTSIDE, SLOPE_OUT] * outer
        outside *= full[g, OUTSIDE, OUTSIDE]
        inside = raw[INSIDE, k] - full[g, INSIDE, OUTSIDE] * outside - full[g, INSIDE, LINE] * line
        inside -= full[g, INSIDE, SLOPE_IN] * inner + full[g, INSIDE, SLOPE_OUT] * outer
        inside *= full[g, INSIDE, INSIDE]
        total += _explained(full, raw, mean, g, k, INSIDE, inside)
        total += _explained(full, raw, mean, g, k, OUTSIDE, outside)
        if narrow:
            total += _explained_behind(space, g, k, inside, outside, line, inner, outer)
        difference = inside - outside
        weight += known * difference**2
        shift += known * difference * line
        lift += known * difference**3 / max(inside + outside, 16.0)
    return total, known, weight, shift, lift
