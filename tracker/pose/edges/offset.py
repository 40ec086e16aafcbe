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

import numpy as np

from tracker.compiled import compiled

MIN_CONTRAST = 14.0
"""Least distance between the two surfaces' colours [levels]."""

RIDGE = 0.003
"""Weight of a surface's prior colour, the mean of its pixels, against one pixel."""

SLOPE = 2.0
"""Standard deviation of a surface's slope of brightness across a silhouette [levels/px]: shading, shadows."""

SHARP, SOFT = 0.3, 0.7
"""Blur [px] at which a picture is drawn rather than taken, so that surfaces are flat; and from which on they
are not. What is left over at a drawn edge is sampling, which slopes must not explain."""

MIN_PIXELS, MAX_PIXELS = 8, 2048
"""Pixels of a piece of an edge below which nothing is measured, and which are looked at at most."""

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

_PER_UNIT = 256
_SPAN = 4.0
_X = (np.arange(int(2 * _SPAN * _PER_UNIT) + 1)) / _PER_UNIT - _SPAN
_STEP = np.array([0.5 * (1 + math.erf(x / math.sqrt(2))) for x in _X])
_LINE = np.exp(-0.5 * _X**2) / math.sqrt(2 * math.pi)

_BLOOM = math.sqrt(math.pi) / 3
"""A response of exponent γ lifts the middle of an edge by (γ - 1) · Δ²/sum · w (1 - w), with w the step and
the sum of both colours; weighted with the line, w (1 - w) is 1/6, and the line's energy 1/(2√π blur)."""


@compiled(inline="always")
def _place(z):  # type: ignore[no-untyped-def]
    """Index of z in the tables of step and line."""
    return int((min(max(z, -_SPAN), _SPAN) + _SPAN) * _PER_UNIT + 0.5)


@compiled(fastmath=True)
def _dot(a, b, n):  # type: ignore[no-untyped-def]
    """Sum of products of the first n; in whatever order is fastest, but always in the same."""
    total = 0.0
    for i in range(n):
        total += a[i] * b[i]
    return total


@compiled(inline="always")
def _columns_of(red, channel, j):  # type: ignore[no-untyped-def]
    """Where in row j of a mosaic a channel was measured: whether in odd columns, or -1 for nowhere."""
    has_red = (j & 1) == red >> 1
    if channel == 1:
        return (red & 1) ^ 1 if has_red else red & 1
    return (red & 1) ^ (channel == 0) if has_red == (channel == 2) else -1


@compiled(error_model="numpy")
def _collect(image, width, height, red, channel, strip, reach, distance, values):  # type: ignore[no-untyped-def]
    """Signed distances (P,) [px] and colours (3, P) of a strip's pixels; returns P, 0 outside the image.

    Of a mosaic (red ≥ 0) only the pixels that measured a channel, which is what counts of their colours.
    """
    u, v, nu, nv, along = strip.pixel[0], strip.pixel[1], strip.normal[0], strip.normal[1], 0.5 * strip.length
    du, dv = abs(nu) * reach + abs(nv) * along, abs(nv) * reach + abs(nu) * along
    if u - du < 0.0 or v - dv < 0.0 or u + du > width - 1.0 or v + dv > height - 1.0:
        return 0
    pixels, step = 0, 1
    for j in range(math.ceil(v - dv), int(v + dv) + 1):
        y = j - v
        # The part of the row whose pixels lie in the strip.
        low, high = u - du, u + du
        if abs(nu) > 1e-9:
            one, two = (-reach - y * nv) / nu, (reach - y * nv) / nu
            low, high = max(low, u + min(one, two)), min(high, u + max(one, two))
        if abs(nv) > 1e-9:
            one, two = (y * nu - along) / nv, (y * nu + along) / nv
            low, high = max(low, u + min(one, two)), min(high, u + max(one, two))
        first = math.ceil(low)
        if red >= 0:
            odd, step = _columns_of(red, channel, j), 2
            if odd < 0:
                continue
            first += (first & 1) ^ odd
        for i in range(first, min(math.floor(high) + 1, first + MAX_PIXELS - pixels), step):
            distance[pixels] = (i - u) * nu + y * nv
            for k in range(3):
                values[k, pixels] = image[j, i, k]
            pixels += 1
    return pixels


@compiled(error_model="numpy")
def _surfaces(strip, seen, edges):  # type: ignore[no-untyped-def]
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


@compiled(error_model="numpy")
def _model(distance, pixels, edges, m, inside, slopes, reach, blur, columns):  # type: ignore[no-untyped-def]
    """Columns (m + slopes + 2, P): the surfaces' shares, the line, slopes, the effect of a change of blur."""
    scale = 1.0 / blur
    for q in range(pixels):
        d = distance[q]
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
def _label(channels, table, color):  # type: ignore[no-untyped-def]
    cell = 0
    for k in range(3):
        cell += channels[k, int(min(255.0, max(0.0, color[k] + 0.5)))]
    return table[cell]


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
def measure(image, width, height, red, channels, table, strips, n, reach, blur, noise, every, out):  # type: ignore[no-untyped-def]
    """Offsets of n pieces of edges: out (n, MEASURED), see OFFSET and below.

    image: (≥ height, ≥ width, 3); red: which pixels of a mosaic measured red (`segmentation.mosaic`), -1 for
    none; reach: half width of the strip of pixels along an edge [px]; blur: standard deviation of the steps
    [px]; noise: least of a pixel's channel [levels].
    """
    # Channels that were measured at the same pixels are solved together; the parts share the shift alone.
    parts = 3 if red >= 0 else 1
    width_of_part = 3 // parts
    factor, full, raw = np.empty((8, 8)), np.empty((parts, 8, 8)), np.zeros((parts, 8, 3))
    found, color, unit, edges = np.empty((parts, 8, 4)), np.empty((2, 3)), np.zeros(8), np.empty(5)
    columns, values, distance = np.empty((8, MAX_PIXELS)), np.empty((3, MAX_PIXELS)), np.empty(MAX_PIXELS)
    slope = SLOPE * min(1.0, max(1e-3, (blur - SHARP) / (SOFT - SHARP)))
    for s in range(n):
        result = out[s]
        result.usable, result.sharpness = False, 0.0
        if s % every:
            continue
        strip = strips[s]
        m, inside = _surfaces(strip, reach + 1.5 * blur, edges)
        slopes = 2 if strip.outside == 0 else 0
        wide = m + slopes + 1
        count, squares = 0, 0.0
        for g in range(parts):
            pixels = _collect(image, width, height, red, g, strip, reach, distance, values)
            _model(distance, pixels, edges, m, inside, slopes, reach, blur, columns)
            for i in range(wide + 1):
                for j in range(i + 1):
                    full[g, i, j] = _dot(columns[i], columns[j], pixels)
                for k in range(g, g + width_of_part):
                    raw[g, i, k] = _dot(columns[i], values[k], pixels)
            for k in range(g, g + width_of_part):
                squares += _dot(values[k], values[k], pixels)
            count += pixels * width_of_part
        if count < 3 * MIN_PIXELS // parts:
            continue
        for g in range(parts):
            _solve(full[g], raw[g], full[g, wide], m, m + 1, 0.0, factor, found[g])
            for k in range(g, g + width_of_part):
                color[0, k], color[1, k] = found[g, inside, k], found[g, inside + 1, k]
        # The surface inside must be the face: a finger's edge is none of the object's.
        here, there = _label(channels, table, color[0]), _label(channels, table, color[1])
        if here != strip.inside or (there != strip.outside if strip.outside > 0 else there == strip.inside):
            continue
        contrast = 0.0
        for k in range(3):
            contrast += (color[0, k] - color[1, k]) ** 2
        if contrast < MIN_CONTRAST**2:
            continue
        misfit, wider, sharpness = squares, 0.0, 0.0
        for g in range(parts):
            misfit = _misfit(full[g], raw[g], misfit, m + 1, found[g], g, g + width_of_part)
            if m == 2:
                one, two = _blurred(full[g], raw[g], found[g], m, wide, inside, g, g + width_of_part)
                wider, sharpness = wider + one, sharpness + two
        variance = _variance(misfit, count - 3 * (m + 1), noise)
        if sharpness > 0.0:
            result.sharpness = sharpness / variance
            result.wider = wider / sharpness
        unit[m] = 1.0
        misfit, weight, shift, lift = squares, 0.0, 0.0, 0.0
        for g in range(parts):
            _solve(full[g], raw[g], unit, m, wide, variance / slope**2, factor, found[g])
            misfit = _misfit(full[g], raw[g], misfit, wide, found[g], g, g + width_of_part)
            known = 1.0 / found[g, m, 3]
            for k in range(g, g + width_of_part):
                difference = found[g, inside, k] - found[g, inside + 1, k]
                weight += known * difference**2
                shift += known * difference * found[g, m, k]
                total = max(found[g, inside, k] + found[g, inside + 1, k], 16.0)
                lift += known * difference**3 / total
        unit[m] = 0.0
        weight = max(weight, MIN_CONTRAST**2 / found[0, m, 3])
        result.offset = min(reach, max(-reach, shift / weight))
        result.variance = _variance(misfit, count - 3 * wide, noise) / weight
        result.bloom = _BLOOM * blur * lift / weight
        result.usable = True
