"""What each pixel says of the dice: seen or not, on a top or a side, on a pip or between pips."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np

from tracker.conventions import Array, Image

SHADE = 0.6
"""Gain of a pixel as bright as the tops if it is explained by a top, loss if by a side; and vice versa."""

PIP = 1.5
"""Loss of a pixel as pale as a pip if it is explained by a part of a face that has none; half of it is the
gain otherwise."""

PALENESS = 0.3
"""Ratio of red to blue of a pip, above that of the dice's blue."""

OUTLINE = 0.3
"""Weight of the mask's outermost pixels: whether they show dice depends on how generous the mask is."""

MIN_PIXELS = 50
"""Pixels of dice in an image below which their shades are not looked at."""


NOTHING, DICE, UNKNOWN = range(3)
"""What a mask says of a pixel."""


class Evidence(NamedTuple):
    """One view's evidence."""

    scores: Array
    """(5, H, W) float32: what is gained where a pixel is explained by NONE, SIDE, SIDE_RIM, TOP, TOP_RIM."""
    mask: Image
    """(H, W) of NOTHING, DICE, UNKNOWN."""
    shade: Array
    """(H, W) float32: from -1, as dark as the sides, to 1, as bright as the tops; 0 unknown."""


def evidence(mask: Image | None, image: Image | None, size: tuple[int, int]) -> Evidence:
    """What a mask (H, W) of dice says, and its BGR image (H, W, 3) if there is one; no mask: nothing."""
    if mask is None:
        unknown = np.full(size, UNKNOWN, np.uint8)
        return Evidence(np.zeros((5, *size), np.float32), unknown, np.zeros(size, np.float32))
    seen = (mask > 0).astype(np.uint8)
    inner = np.asarray(cv2.erode(seen, np.ones((3, 3), np.uint8)), dtype=np.uint8)
    shade = pale = np.zeros(size, np.float32)
    if image is not None and np.count_nonzero(inner) >= MIN_PIXELS:
        pale = _paleness(image, inner)
        shade = _shade(image, seen, inner) * (1 - pale)
    weight = np.where(inner > 0, np.float32(1), np.float32(OUTLINE))
    tops, pips = SHADE * shade, PIP * pale
    scores = np.zeros((5, *size), np.float32)
    for k, score in enumerate((1 - tops + pips / 2, 1 - tops - pips, 1 + tops + pips / 2, 1 + tops - pips)):
        scores[k + 1] = np.where(seen > 0, weight * score, np.float32(-1))
    return Evidence(scores, seen, shade)


def _shade(image: Image, seen: Image, inner: Image) -> Array:
    """How bright the dice's blue is, between the means of the darker and the brighter ones of two classes."""
    blue = image[..., 0]
    levels = blue[inner > 0]
    border, _ = cv2.threshold(levels[:, None], 0, 255, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
    bright, dark = levels[levels > border], levels[levels <= border]
    if not (len(bright) and len(dark)):
        return np.zeros(seen.shape, np.float32)
    high, low = float(bright.mean()), float(dark.mean())
    shade = (blue.astype(np.float32) - (high + low) / 2) * (2 / (high - low))
    return np.where(seen > 0, np.clip(shade, -1, 1), np.float32(0))


def _paleness(image: Image, inner: Image) -> Array:
    """From 0, blue, to 1, a pip; 0 at the mask's edge, where the blue mixes with what is beyond."""
    ratio = (image[..., 2] + np.float32(5)) / (image[..., 0] + np.float32(5))
    usual = np.float32(np.median(ratio[inner > 0]))
    return np.where(inner > 0, np.clip((ratio - usual) / np.float32(PALENESS), 0, 1), np.float32(0))


def tops(views: Sequence[Evidence]) -> list[Array]:
    """(H, W) float32 of each view: from -0.7, no dice, to 1, as bright as a die's top; 0 unknown."""
    result = []
    for view in views:
        shaded = bool(view.shade.any())
        seen = 0.4 + 0.6 * view.shade if shaded else np.full(view.mask.shape, 0.5, np.float32)
        result.append(np.choose(view.mask, (np.float32(-0.7), seen, np.float32(0))).astype(np.float32))
    return result


def stack(views: Sequence[Evidence]) -> tuple[Array, Image]:
    """Scores (C, 5, H, W) and masks (C, H, W) of views whose sizes may differ; the rest is unknown."""
    height, width = (max(view.mask.shape[k] for view in views) for k in (0, 1))
    scores = np.zeros((len(views), 5, height, width), np.float32)
    masks = np.full((len(views), height, width), UNKNOWN, np.uint8)
    for c, view in enumerate(views):
        h, w = view.mask.shape
        scores[c, :, :h, :w], masks[c, :h, :w] = view.scores, view.mask
    return scores, masks
