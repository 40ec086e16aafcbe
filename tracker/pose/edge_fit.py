"""Locate an edge to a fraction of a pixel, from the pixels around it.

Near an edge the image is a sum of blurred steps between surfaces of locally constant colour: the face inside,
the face or background outside, and what lies beyond a narrow face. With the steps where the pose puts them,
linear least squares on the pixels yields the colours and a small shift of the edge. Gains, exposure and
shading cancel, because only local colours count, and the blur of a narrow face into its neighbours is
modelled.

Local colour statistics on both sides of a contour go back to R. Hanek and M. Beetz, "The Contracting Curve
Density Algorithm", IJCV 59(3), 2004; here the colours are eliminated in closed form, and each piece of an
edge yields one offset.

In order: the elimination of the surfaces, the solution, the measurement.
"""

import math

import numpy as np

from tracker.compiled import compiled
from tracker.geometry.lens import clamped
from tracker.pose.edge_model import (
    BEFORE,
    BEYOND,
    BLUR,
    INSIDE,
    LINE,
    OUTSIDE,
    RIDGE,
    SLOPE_IN,
    SLOPE_OUT,
    edge_products,
    model,
    narrow_model,
    narrow_products,
)
from tracker.pose.strips import padded

MIN_CONTRAST = 14.0
"""Smallest difference between the two surfaces' colours [levels]."""

SLOPE = 2.0
"""Standard deviation of a surface's brightness gradient across a silhouette [levels/px]: shading, shadows."""

SHARP, SOFT = 0.3, 0.7
"""Blur [px] below which an image counts as rendered, with flat surfaces, and above which as a photograph.
At a rendered edge the remaining residual comes from sampling, which gradients must not explain."""

NOISE = 1.5
"""Smallest standard deviation of a pixel's channel [levels]; residuals raise it."""

MIN_PIXELS = 8
"""Minimum number of pixels to measure a piece of edge."""

LEAST_PIVOT = 1e-9
"""Smallest pivot used as a divisor."""


OFFSET = np.dtype(
    [
        ("offset", np.float64),  # of the edge from its expected position, along the normal [px]
        ("variance", np.float64),  # of the offset, from noise [px²]
        ("bloom", np.float64),  # apparent offset caused by a response exponent of 2 instead of 1 [px]
        ("wider", np.float64),  # by how much the edge's blur exceeds the assumed one [px], …
        ("sharpness", np.float64),  # … and the weight of that; 0: unknown
        ("usable", np.bool_),  # whether there is an offset
    ]
)
"""Measurement of an edge by a strip of pixels."""


_BLOOM = math.sqrt(math.pi) / 3
"""A response of exponent γ raises the middle of an edge by (γ - 1) · Δ²/sum · w (1 - w), with the step w and
the sum of both colours; weighted with the line, w (1 - w) is 1/6, and the line's energy 1/(2√π blur)."""


@compiled
def eliminate_surfaces(space, g, part, narrow, slopes):  # type: ignore[no-untyped-def]
    """Eliminate the surfaces' colours from space.full[g] and .raw, for `part` channels from g on.

    BLUR's own row is left out: only how the others depend on it is needed.
    """
    full, raw = space.full, space.raw
    last = SLOPE_OUT + 1 if slopes else LINE + 1
    for i in range(BEFORE if narrow else INSIDE, OUTSIDE + 1):
        pivot = 1.0 / max(full[g, i, i], LEAST_PIVOT)
        full[g, i, i] = pivot
        for j in range(i + 1, last):
            factor = full[g, i, j] * pivot
            for k in range(j, BLUR + 1):
                full[g, j, k] -= factor * full[g, i, k]
            for k in range(g, g + part):
                raw[j, k] -= factor * raw[i, k]


@compiled
def _explained(full, raw, mean, g, k, i, x):  # type: ignore[no-untyped-def]
    """How much a surface of colour x reduces the sum of squares."""
    return raw[i, k] ** 2 * full[g, i, i] + RIDGE * x * (x - 2.0 * mean[i, k])


@compiled
def _explained_behind(space, g, k, inside, outside, line, inner, outer):  # type: ignore[no-untyped-def]
    """How much surfaces behind narrow ones reduce the sum of squares, given the other unknowns."""
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
def fit_blur(space, g, part):  # type: ignore[no-untyped-def]
    """Return the evidence for a change of blur that colours and shift do not explain, and its weight.

    See equation (11) of docs/how-it-works.md. It assumes no narrow surfaces.
    """
    full, raw, wider, contrast = space.full, space.raw, 0.0, 0.0
    aw, bw, ew = full[g, INSIDE, BLUR], full[g, OUTSIDE, BLUR], full[g, LINE, BLUR]
    a, b, e = full[g, INSIDE, INSIDE], full[g, OUTSIDE, OUTSIDE], 1.0 / max(full[g, LINE, LINE], LEAST_PIVOT)
    own = full[g, BLUR, BLUR] - aw * aw * a - bw * bw * b - ew * ew * e
    if own <= 1e-3 * full[g, BLUR, BLUR]:
        return 0.0, 0.0
    for k in range(g, g + part):
        off = raw[BLUR, k] - aw * a * raw[INSIDE, k] - bw * b * raw[OUTSIDE, k] - ew * e * raw[LINE, k]
        difference = space.color[0, k] - space.color[1, k]
        wider -= difference * off
        contrast += difference**2
    return wider, contrast * own


@compiled
def fit_edge(space, g, part, narrow, slopes, stiffness):  # type: ignore[no-untyped-def]
    """Solve for the edge's shift and, if `slopes`, for gradients with the prior information `stiffness`.

    This is equation (9) of docs/how-it-works.md. The colours inside and outside are put into space.color.
    Return the reduction of the sum of squares, the information on the shift at a contrast of 1, and the sums
    over channels of the weight, the weighted shift and the weighted bloom.
    """
    full, raw, mean = space.full, space.raw, space.mean
    known, i, o, io, ei, eo = full[g, LINE, LINE], 0.0, 0.0, 0.0, 0.0, 0.0
    if slopes:
        i = 1.0 / max(full[g, SLOPE_IN, SLOPE_IN] + stiffness, LEAST_PIVOT)
        io = full[g, SLOPE_IN, SLOPE_OUT]
        o = 1.0 / max(full[g, SLOPE_OUT, SLOPE_OUT] + stiffness - io * io * i, LEAST_PIVOT)
        ei = full[g, LINE, SLOPE_IN]
        eo = full[g, LINE, SLOPE_OUT] - ei * io * i
        known -= ei * ei * i + eo * eo * o
    known = max(known, LEAST_PIVOT)
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
        space.color[0, k], space.color[1, k] = inside, outside
        difference = inside - outside
        weight += known * difference**2
        shift += known * difference * line
        lift += known * difference**3 / max(inside + outside, 16.0)
    return total, known, weight, shift, lift


@compiled
def _label(channels, table, color):  # type: ignore[no-untyped-def]
    cell = 0
    for k in range(3):
        cell += channels[k, clamped(color[k] + 0.5, 255)]
    return table[cell]


@compiled
def _variance(squares, degrees):  # type: ignore[no-untyped-def]
    """Variance of a pixel's channel from the residuals, at least that of the noise."""
    return max(NOISE * NOISE, squares / max(degrees, 1))


@compiled
def _is_of_face(strip, color, channels, table):  # type: ignore[no-untyped-def]
    """Whether colours (2, 3) are the face's (inside) and another surface's (outside), and differ enough."""
    # The surface inside must be the face: the edge of a finger is not the object's.
    here, there = _label(channels, table, color[0]), _label(channels, table, color[1])
    if here != strip.inside or (there != strip.outside if strip.outside > 0 else there == strip.inside):
        return False
    contrast = 0.0
    for k in range(3):
        contrast += (color[0, k] - color[1, k]) ** 2
    return contrast >= MIN_CONTRAST**2


@compiled
def _add_up(strip, at, narrow, slopes, pixels, space):  # type: ignore[no-untyped-def]
    """Fill the products of a strip's model for each part, and eliminate the surfaces from them."""
    (parts, shift, reach, blur), (distance, values) = at, pixels
    part, start = 3 // parts, strip.first[0]
    end = strip.first[parts - 1] + padded(strip.count[parts - 1])
    model(distance, start, end, shift, slopes, reach, blur, space)
    if narrow:
        narrow_model(strip, distance, start, end, shift, slopes, reach, blur, space)
    for g in range(parts):
        first, count = strip.first[g] - start, strip.count[g]
        last = first + padded(count)
        edge_products(space, values, start, first, last, count, g, part, slopes)
        if narrow:
            narrow_products(space, values, start, first, last, g, part)
        eliminate_surfaces(space, g, part, narrow, slopes)


@compiled
def _fit_parts(strip, parts, narrow, slopes, stiffness, space):  # type: ignore[no-untyped-def]
    """Sum `fit_edge` over the parts; return squares left, the first part's information, and other sums."""
    left, weight, shift, lift, certain = strip.squares, 0.0, 0.0, 0.0, 0.0
    for g in range(parts):
        explained, known, one, two, three = fit_edge(space, g, 3 // parts, narrow, slopes, stiffness)
        left, weight, shift, lift = left - explained, weight + one, shift + two, lift + three
        if g == 0:
            certain = known
    return left, certain, weight, shift, lift


@compiled
def _measure(strip, at, pixels, channels, table, space, found):  # type: ignore[no-untyped-def]
    """Measure the offset of one strip; at: parts, shift of the edge, reach, blur. See `measure`.

    See equation (10) of docs/how-it-works.md for offset and variance, and equation (12) of
    docs/how-it-works.md for bloom.
    """
    parts, _, reach, blur = at
    part, seen, slopes = 3 // parts, reach + 1.5 * blur, strip.outside == 0
    count = part * (strip.count[0] + strip.count[1] + strip.count[2])
    surfaces = 2 + int(strip.reach_in < seen) + int(strip.reach_out < seen)
    narrow, unknowns, wider, sharpness = surfaces > 2, 3 * (surfaces + 1), 0.0, 0.0
    _add_up(strip, at, narrow, slopes, pixels, space)
    left, certain, weight, shift, lift = _fit_parts(strip, parts, narrow, False, 0.0, space)
    if not _is_of_face(strip, space.color, channels, table):
        return
    for g in range(0 if narrow else parts):
        one, two = fit_blur(space, g, part)
        wider, sharpness = wider + one, sharpness + two
    variance = _variance(left, count - unknowns)
    found.sharpness = sharpness / variance
    found.wider = wider / sharpness
    if slopes:
        slope = SLOPE * min(1.0, max(1e-3, (blur - SHARP) / (SOFT - SHARP)))
        stiffness, unknowns = variance / slope**2, unknowns + 6
        left, certain, weight, shift, lift = _fit_parts(strip, parts, narrow, True, stiffness, space)
        variance = _variance(left, count - unknowns)
    weight = max(weight, MIN_CONTRAST**2 * certain)
    found.offset = min(reach, max(-reach, shift / weight))
    found.variance = variance / weight
    found.bloom = _BLOOM * blur * lift / weight
    found.usable = True


@compiled
def measure(strips, camera, channels, table, blur, every, pixels, scratch, found):  # type: ignore[no-untyped-def]
    """Measure the offsets of the strips in one image: found (n,) of OFFSET.

    Channels measured at the same pixels are solved together; the parts of a mosaic share only the shift.

    camera (`solve.CAMERA`): number of strips, their half width, parts, and the motion since they were
    collected; channels (3, 256), table (64³,): how colours map to labels; blur: standard deviation of the
    edges' blur [px]; every: measure only every n-th strip; pixels: distance (P,), values (3, P); scratch
    (1,) of SCRATCH.
    """
    parts = camera.parts
    for s in range(camera.strips):
        strip, result = strips[s], found[s]
        result.usable, result.sharpness = False, 0.0
        count = strip.count[0] + strip.count[1] + strip.count[2]
        if s % every or count < MIN_PIXELS:
            continue
        shift = 0.0
        for i in range(6):
            shift += strip.jacobian[i] * camera.motion[i]
        _measure(strip, (parts, shift, camera.reach, blur), pixels, channels, table, scratch[0], result)
