"""The pixels of the strips along edges: collected once, then only their distances move with the pose."""

from __future__ import annotations

import math

import numpy as np

from tracker.compiled import compiled
from tracker.segmentation.light import CLIPPED

LARGE = 2.0
"""Size of the object over the reference from which on pixels are left out, since there are plenty."""

MAX_PIXELS = 1024
"""Pixels of a strip, at most: a multiple of BLOCK."""

BLOCK = 8
"""Each strip's pixels begin at a multiple of this, so that their sums are made of whole vectors."""

FAR = 1e6
"""Distance [px] of what fills the gaps."""

SUMS = {"reassoc", "contract", "nsz"}
"""Fastmath of sums: in whatever order is fastest, but always in the same."""


@compiled(inline="always")
def padded(count):  # type: ignore[no-untyped-def]
    """Places of so many pixels with the gap after them."""
    return (count + BLOCK - 1) // BLOCK * BLOCK


@compiled(inline="always")
def _columns_of(red, channel, j):  # type: ignore[no-untyped-def]
    """Where in row j of a mosaic a channel was measured: whether in odd columns, or -1 for nowhere."""
    has_red = (j & 1) == red >> 1
    if channel == 1:
        return (red & 1) ^ 1 if has_red else red & 1
    return (red & 1) ^ (channel == 0) if has_red == (channel == 2) else -1


@compiled(inline="always")
def _in_view(strip, reach, width, height):  # type: ignore[no-untyped-def]
    """Whether a strip lies in the picture as a whole."""
    along = 0.5 * strip.length
    du = abs(strip.normal[0]) * reach + abs(strip.normal[1]) * along
    dv = abs(strip.normal[1]) * reach + abs(strip.normal[0]) * along
    u, v = strip.pixel[0], strip.pixel[1]
    return u - du >= 0.0 and v - dv >= 0.0 and u + du <= width - 1.0 and v + dv <= height - 1.0


@compiled
def _collect(image, tilt, red, channel, strip, reach, stride, start, distance, values):  # type: ignore[no-untyped-def]
    """Signed distances [px] and colours of a strip's pixels, from place `start` on; returns their count.

    Of a mosaic (red ≥ 0) only the pixels that measured a channel, which is what counts of their colours.
    """
    u, v, nu, nv, along = strip.pixel[0], strip.pixel[1], strip.normal[0], strip.normal[1], 0.5 * strip.length
    du, dv = abs(nu) * reach + abs(nv) * along, abs(nv) * reach + abs(nu) * along
    # The light's slope over a strip is small: its factors are taken to be linear.
    across, down = 2.0 / image.shape[1], 2.0 / image.shape[0]
    even = tilt[0, 0] == 0.0 and tilt[0, 1] == 0.0 and tilt[1, 0] == 0.0 and tilt[1, 1] == 0.0
    blue = 1.0 if even else math.exp(-tilt[0, 0] * (u * across - 1.0) - tilt[0, 1] * (v * down - 1.0))
    red_ = 1.0 if even else math.exp(-tilt[1, 0] * (u * across - 1.0) - tilt[1, 1] * (v * down - 1.0))
    last = min(start + MAX_PIXELS, len(distance))
    place, step = start, stride
    for j in range(math.ceil(v - dv), int(v + dv) + 1, stride):
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
        for i in range(first, min(math.floor(high) + 1, first + step * (last - place)), step):
            x = i - u
            distance[place] = x * nu + y * nv
            b, g, r = image[j, i, 0], image[j, i, 1], image[j, i, 2]
            values[0, place], values[1, place], values[2, place] = b, g, r
            place += 1
            if even:
                continue
            bend = 1.0 - tilt[0, 0] * across * x - tilt[0, 1] * down * y
            values[0, place - 1] = 255.0 if b >= CLIPPED else min(b * blue * bend, CLIPPED - 1.0)
            bend = 1.0 - tilt[1, 0] * across * x - tilt[1, 1] * down * y
            values[2, place - 1] = 255.0 if r >= CLIPPED else min(r * red_ * bend, CLIPPED - 1.0)
    return place - start


@compiled(fastmath=SUMS)
def _sum_of_squares(values, first, last):  # type: ignore[no-untyped-def]
    """Of values (P,) from place to place."""
    total = 0.0
    for i in range(np.uint64(first), np.uint64(last)):
        total += values[i] * values[i]
    return total


@compiled
def collect(image, tilt, red, strips, n, reach, scale, every, distance, values):  # type: ignore[no-untyped-def]
    """Collect the pixels of n strips of one picture (H, W, 3) into distance (P,) and values (3, P).

    tilt (2, 2): the light's slope (`segmentation.light.Light`); red: which pixels of a mosaic measured red
    (`segmentation.mosaic`), -1 for none; reach: half width of the strips [px]; scale: size of the object over
    the reference; every: one in so many strips gets pixels. Each strip learns where its pixels are; of a
    mosaic each channel has its own. The gaps before the next multiple of BLOCK are filled with FAR and 0; P
    must be such a multiple.
    """
    start, parts = 0, 3 if red >= 0 else 1
    stride = max(1, int(scale / LARGE)) if red < 0 else 1
    for s in range(n):
        strip = strips[s]
        strip.in_view = _in_view(strip, reach, image.shape[1], image.shape[0])
        strip.squares = 0.0
        for part in range(3):
            strip.first[part], strip.count[part] = start, 0
            if not strip.in_view or part >= parts or s % every:
                continue
            count = _collect(image, tilt, red, part, strip, reach, stride, start, distance, values)
            end = start + padded(count)
            for k in range(part, part + 3 // parts):
                for i in range(start + count, end):
                    distance[i], values[k, i] = FAR, 0.0
                strip.squares += _sum_of_squares(values[k], start, end)
            strip.count[part], start = count, end
