"""Which pixels of an image show dice.

A colour table finds the inside of the faces for certain. What is blue but nowhere as bright as a die, like
paint on the table, is dropped. From there the mask grows to the edge, where the ratio of blue to red has
fallen by a fixed share of what it is inside: that follows the blue into shade, and stops in the blur between
dice and whatever else. White pips are closed.
"""

from __future__ import annotations

import cv2
import numpy as np

from tracker.compiled import compiled
from tracker.conventions import Array, Image
from tracker.segmentation.color_model import ColorModel, check_colors, load_colors
from tracker.segmentation.labels import FINE, REFERENCE_SIZE, check_image
from tracker.segmentation.light import TARGET_GREY, evened, find_light
from tracker.segmentation.sensor import calmed

CERTAIN = 32
"""Log odds, in 1/16, from which a pixel is taken for the inside of a face."""

MIN_INSIDE = 12
"""Pixels of the inside within a window, at the reference size, without which a pixel is a speck."""

EDGE = 0.42
"""Share of the inside's log ratio of blue to red that a pixel at the edge must have: 0.5 would be the middle
of the blur; people who draw masks by hand are a little more generous."""

RIM = 0.03
"""Weight of the inside's outermost pixels in the mean of their surroundings."""

OFFSET = 20.0
"""Added to both levels before their ratio is taken: noise in the dark must not look like colour."""

BRIGHT, BRIGHTEST = 0.6, 0.9
"""Level of blue, over this quantile of it inside, that tops of dice reach, and paint on tables does not."""

LEAST_BRIGHT = 0.9
"""The same over the level of the scene's greys, where there are no dice to compare with."""

WIDE = 9
"""Width [px at the reference size] that the sides of dice have, and lines of paint do not."""

STEPS = 2
"""Steps of 3 px at the reference size from where it is bright or wide to the die's other pixels."""

PALE = 0.8
"""Level of green, over that inside the face, from which a gap in the blue is a pip."""


@compiled
def read_levels(image, channels, table, ratios, gain, certain, inside, ratio, blue):  # type: ignore[no-untyped-def]
    """Per pixel: whether the table is certain, the log ratio of blue to red, and the level of blue."""
    for j in range(image.shape[0]):
        for i in range(image.shape[1]):
            b, g, r = image[j, i, 0], image[j, i, 1], image[j, i, 2]
            cell = channels[0, b] + channels[1, g] + channels[2, r]
            inside[j, i] = 1 if table[cell] >= certain else 0
            ratio[j, i] = ratios[0, b] - ratios[1, r]
            blue[j, i] = min(int(gain * b), 255)


@compiled
def weigh_inside(image, inside, core, ratio, least, out):  # type: ignore[no-untyped-def]
    """Out (H, W, 3) = weight, weight · ratio, weight · green of the inside; `least` for its rim."""
    for j in range(image.shape[0]):
        for i in range(image.shape[1]):
            weight = np.float32(0.0)
            if inside[j, i]:
                weight = np.float32(1.0 if core[j, i] else least)
            out[j, i, 0] = weight
            out[j, i, 1] = weight * ratio[j, i]
            out[j, i, 2] = weight * np.float32(image[j, i, 1])


@compiled
def grow_mask(image, near, sums, ratio, edge, pale, mask, light):  # type: ignore[no-untyped-def]
    """Mask: 255 where the ratio is at least `edge` of the inside's; light: 255 where a pip may be."""
    for j in range(image.shape[0]):
        for i in range(image.shape[1]):
            weight = sums[j, i, 0]
            mask[j, i] = light[j, i] = 0
            if weight <= 0.0:
                continue
            if near[j, i] and ratio[j, i] * weight >= edge * max(sums[j, i, 1], np.float32(0.1) * weight):
                mask[j, i] = 255
            if image[j, i, 1] * weight >= pale * sums[j, i, 2]:
                light[j, i] = 255


def segment_dice(image: Array, colors: ColorModel | None = None) -> Image:
    """The dice in an image: (H, W) uint8, 255 where a pixel shows one, else 0.

    Pips, shaded sides and the dice's edges are included; fingers in front of the dice are not.

    Args:
        image: (H, W, 3) uint8 BGR, 270 or 540 px high; lengths scale with the height.
        colors: a colour model, in any of whose face colours the dice are; by default `dice`.

    Raises:
        ImageError: the image is of another shape or type.
        ColorModelError: the colours are anything but a colour model.
    """
    image = check_image(image)
    colors = load_colors("dice") if colors is None else check_colors(colors)
    scale = min(image.shape[:2]) / REFERENCE_SIZE
    # Demosaicing leaves single wrong pixels at the finer resolution.
    image = np.asarray(cv2.medianBlur(image, 3), dtype=np.uint8) if scale > FINE else calmed(image)
    light_of_scene = find_light(image)
    image = evened(image, light_of_scene)
    gains = light_of_scene.gains if colors.normalise else np.ones(3)

    inside, blue = np.empty(image.shape[:2], np.uint8), np.empty(image.shape[:2], np.uint8)
    ratio = np.empty(image.shape[:2], np.float32)
    ratios = np.log(np.outer(gains[[0, 2]], np.arange(256)) + OFFSET).astype(np.float32)
    channels = colors.channel_tables(gains)
    read_levels(image, channels, colors.margin_table, ratios, gains[0], CERTAIN, inside, ratio, blue)
    inside = np.asarray(cv2.medianBlur(inside, 3), dtype=np.uint8)
    mask: Image = np.zeros(image.shape[:2], np.uint8)
    left, top, width, height = cv2.boundingRect(inside)
    if width:
        margin = _odd(7 * scale)  # what may grow from the inside
        rows = slice(max(top - margin, 0), top + height + margin)
        part = rows, slice(max(left - margin, 0), left + width + margin)
        own = np.ascontiguousarray
        mask[part] = _mask(own(image[part]), own(inside[part]), own(blue[part]), own(ratio[part]), scale)
    return mask


def _mask(image: Image, inside: Image, blue: Image, ratio: Array, scale: float) -> Image:
    """The mask (0, 255) that grows from the inside."""
    window = _odd(7 * scale)
    count = cv2.boxFilter(inside, cv2.CV_16U, (window, window), normalize=False)
    inside &= (count >= MIN_INSIDE * scale * scale).view(np.uint8)
    inside = _reached(inside, np.asarray(cv2.blur(blue, (3, 3)), dtype=np.uint8), scale)
    sums: Array = np.empty(image.shape, np.float32)
    mask, pips = np.empty_like(inside), np.empty_like(inside)
    weigh_inside(image, inside, cv2.erode(inside, _round(3 * scale)), ratio, RIM, sums)
    sums = cv2.boxFilter(sums, -1, (window, window), normalize=False)
    grow_mask(image, cv2.dilate(inside, _square(5 * scale)), sums, ratio, EDGE, PALE, mask, pips)
    closed = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, _round(5 * scale))
    mask |= np.asarray(closed, dtype=np.uint8) & pips
    return np.asarray(cv2.morphologyEx(mask, cv2.MORPH_CLOSE, _round(3 * scale)), dtype=np.uint8)


def _reached(inside: Image, blue: Image, scale: float) -> Image:
    """The inside's pixels that a path within it joins to bright ones nearby, or to where it is wide."""
    levels = cv2.calcHist([blue], [0], inside, [256], [0, 256])
    brightest = int(np.searchsorted(np.cumsum(levels), BRIGHTEST * levels.sum()))
    bright = (blue >= max(BRIGHT * brightest, LEAST_BRIGHT * TARGET_GREY)).astype(np.uint8)
    closed = cv2.morphologyEx(inside, cv2.MORPH_CLOSE, _square(3 * scale))
    wide = cv2.morphologyEx(closed, cv2.MORPH_OPEN, _square(WIDE * scale))
    reached: Image = inside & (bright | np.asarray(wide, dtype=np.uint8))
    for _ in range(STEPS):
        cv2.bitwise_and(cv2.dilate(reached, _square(7 * scale)), inside, dst=reached)
    return reached


def _odd(size: float) -> int:
    return 2 * round((size - 1) / 2) + 1


def _square(size: float) -> Image:
    return np.ones((_odd(size), _odd(size)), np.uint8)


def _round(size: float) -> Image:
    shape = (_odd(size), _odd(size))
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, shape), dtype=np.uint8)
