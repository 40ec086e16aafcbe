"""Take the light out of an image: scale its channels so that the scene's greys become one grey.

The platform is grey almost everywhere (wall, table, robot), so the most frequent chromaticity is
that of neutral grey under this camera's white balance. Its mean gives the channel gains, its brighter
pixels the exposure.
"""

from __future__ import annotations

import numba
import numpy as np

from tracker.conventions import FloatArray, Image

TARGET_GREY = 115.0
"""Level to which the scene's greys are brought."""

SAMPLES = 3000
"""Pixels that are looked at; more do not change the result by a level."""

CLIPPED = 250
"""A channel at this level or above may be clipped."""

BRIGHTNESS_RANK = 0.7
"""Rank of the grey pixel whose brightness counts: the wall's, also where table and robot are dark."""

_BINS = 56
_RANGE = 1.75
_LOG = np.log(np.maximum(np.arange(256), 0.5))


@numba.njit(cache=True, nogil=True)
def _grey_mode(image, step, log_table, gains):  # type: ignore[no-untyped-def]
    """Write the gains (3,) that make the most frequent chromaticity grey; returns its share of pixels."""
    height, width = image.shape[0], image.shape[1]
    histogram = np.zeros((_BINS + 2, _BINS + 2), np.int32)
    scale = _BINS / (2 * _RANGE)
    count = 0
    for j in range(step // 2, height, step):
        for i in range(step // 2, width, step):
            b, g, r = image[j, i, 0], image[j, i, 1], image[j, i, 2]
            if max(b, g, r) >= CLIPPED or min(b, g, r) < 6 or max(b, g, r) < 12:
                continue
            u = (log_table[b] - log_table[g] + _RANGE) * scale
            v = (log_table[r] - log_table[g] + _RANGE) * scale
            if 0 <= u < _BINS and 0 <= v < _BINS:
                histogram[int(u) + 1, int(v) + 1] += 1
                count += 1
    if count < 50:
        return 0.0
    best, u0, v0 = -1, 0, 0
    for iu in range(1, _BINS + 1):
        for iv in range(1, _BINS + 1):
            total = 0
            for du in range(-1, 2):
                for dv in range(-1, 2):
                    total += histogram[iu + du, iv + dv]
            if total > best:
                best, u0, v0 = total, iu, iv
    u_mean = (u0 - 0.5) / scale - _RANGE
    v_mean = (v0 - 0.5) / scale - _RANGE
    inside = 0
    levels = np.zeros(256, np.int64)
    for round_ in range(4):
        reach = 0.22 if round_ == 0 else 0.15
        su, sv, inside = 0.0, 0.0, 0
        for j in range(step // 2, height, step):
            for i in range(step // 2, width, step):
                b, g, r = image[j, i, 0], image[j, i, 1], image[j, i, 2]
                low, high = min(b, g, r), max(b, g, r)
                if high >= CLIPPED:
                    # A clipped grey says nothing on chromaticity, but it does say "bright".
                    if round_ == 3 and low > 100:
                        levels[g] += 1
                    continue
                if low < 6 or high < 12:
                    continue
                u = log_table[b] - log_table[g]
                v = log_table[r] - log_table[g]
                if abs(u - u_mean) < reach and abs(v - v_mean) < reach:
                    su += u
                    sv += v
                    inside += 1
                    if round_ == 3:
                        levels[g] += 1
        if inside < 20:
            return 0.0
        u_mean, v_mean = su / inside, sv / inside
    below = int(levels.sum() * BRIGHTNESS_RANK)
    running, level = 0, 0
    while running <= below:
        running += levels[level]
        level += 1
    green = level - 1.0
    gains[0] = TARGET_GREY / (green * np.exp(u_mean))
    gains[1] = TARGET_GREY / green
    gains[2] = TARGET_GREY / (green * np.exp(v_mean))
    return inside / count


def neutral_gains(image: Image) -> tuple[FloatArray, float]:
    """Gains (3,) that bring the most frequent chromaticity to TARGET_GREY, and its share of the pixels.

    The share is 0, and the gains 1, where no grey can be found (a black, white or monochrome image).
    """
    step = max(1, int(np.sqrt(image.shape[0] * image.shape[1] / SAMPLES)))
    gains = np.ones(3)
    share = _grey_mode(image, step, _LOG, gains)
    return gains, float(share)


def grey_world_gains(image: Image) -> FloatArray:
    """Gains (3,) that bring the mean of each channel to that of the platform's usual images.

    A second opinion where the wall is clipped: clipped pixels still pull their channel's mean.
    """
    step = max(1, int(np.sqrt(image.shape[0] * image.shape[1] / SAMPLES)))
    mean = image[step // 2 :: step, step // 2 :: step].reshape(-1, 3).mean(axis=0)
    return np.asarray(0.8 * TARGET_GREY / np.maximum(mean, 1.0), dtype=np.float64)


def apply_gains(image: Image, gains: FloatArray) -> Image:
    """The image with its channels multiplied by `gains` (3,), rounded and clipped to 8 bits."""
    levels = np.arange(256)[:, None] * np.asarray(gains)[None, :]
    tables = np.clip(np.rint(levels), 0, 255).astype(np.uint8)
    channels = [tables[:, c][image[..., c]] for c in range(3)]
    return np.stack(channels, axis=-1)
