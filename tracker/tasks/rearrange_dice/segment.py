"""Segment the pixels of an image that show dice.

A colour table selects pixels that are certainly inside a face. Blue regions that are nowhere as bright as a
die, such as paint on the table, are dropped. From the rest the mask grows until the log ratio of blue to red
falls below a fixed share of its value inside. This follows the blue into the shade, and stops in the blur
between dice and their surroundings. White pips are filled.
"""

import cv2
import numpy as np

from tracker.checks import of_kind
from tracker.compiled import compiled
from tracker.conventions import Array, Image
from tracker.errors import ColorModelError
from tracker.segmentation.color_model import ColorModel, load_colors
from tracker.segmentation.labels import FINE_IMAGE, REFERENCE_SIZE, check_image, in_even_light, may_be_grey
from tracker.segmentation.light import TARGET_GREY, find_light
from tracker.segmentation.sensor import calmed

CERTAIN = 32
"""Smallest log odds, in 1/16, at which a pixel is certainly inside a face."""

MIN_INSIDE = 12
"""An inside pixel with fewer than this in the window around it is a speck [px² at the reference size]."""

EDGE = 0.42
"""Smallest log ratio of blue to red in the mask, as a share of that inside: 0.5 would be the middle of the
blur; masks drawn by hand are a little more generous."""

RIM = 0.03
"""Weight of the outermost inside pixels in local means."""

OFFSET = 20.0
"""Level added to both channels before taking their ratio, so that dark noise does not look coloured."""

BRIGHT, BRIGHTEST = 0.6, 0.9
"""Share, of this quantile of the blue inside, that dice tops reach but paint on tables does not."""

LEAST_BRIGHT = 0.9
"""Lower bound of that level, relative to the scene's greys, in case there are no dice to compare with."""

WIDE = 9
"""Smallest width of the sides of dice; lines of paint are narrower [px at the reference size]."""

STEPS = 2
"""Number of steps, 3 px each at the reference size, from bright or wide pixels to the rest of the die."""

PALE = 0.8
"""Smallest level of green, relative to that inside the face, at which a gap in the blue is a pip."""


@compiled
def read_levels(image, channels, table, ratios, gains, gain, inside, ratio, blue):  # type: ignore[no-untyped-def]
    """Fill (H, W) inside (1: certain), ratio (log of blue over red; 0: clipped grey) and blue (its level)."""
    for j in range(image.shape[0]):
        for i in range(image.shape[1]):
            b, g, r = image[j, i, 0], image[j, i, 1], image[j, i, 2]
            grey = may_be_grey(b, g, r, gains)
            cell = channels[0, b] + channels[1, g] + channels[2, r]
            inside[j, i] = 1 if table[cell] >= CERTAIN and not grey else 0
            ratio[j, i] = 0.0 if grey else ratios[0, b] - ratios[1, r]
            blue[j, i] = min(int(gain * b), 255)


@compiled
def weigh_inside(image, inside, core, ratio, least, out):  # type: ignore[no-untyped-def]
    """Fill out (H, W, 3): weight, weight · ratio, weight · green; weight: 1 inside, `least` at its rim."""
    for j in range(image.shape[0]):
        for i in range(image.shape[1]):
            weight = np.float32(1.0 if core[j, i] else least * inside[j, i])
            out[j, i, 0] = weight
            out[j, i, 1] = weight * ratio[j, i]
            out[j, i, 2] = weight * np.float32(image[j, i, 1])


@compiled
def grow_mask(image, near, sums, ratio, edge, pale, mask, light):  # type: ignore[no-untyped-def]
    """Fill mask: 255 where the ratio is at least `edge` of the inside's; light: 255 where a pip may be."""
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
    """Return the mask of dice in an image: (H, W) uint8, 255 where a pixel shows one, else 0.

    Pips, shaded sides and the dice's edges are included; fingers in front of the dice are not.

    Args:
        image: (H, W, 3) uint8 BGR, 270 or 540 px high; lengths scale with its shorter side.
        colors: a colour model, whose bluish face colours count as dice; by default `dice`.

    Raises:
        ImageError: the image has the wrong shape or type.
        ColorModelError: `colors` is not a colour model.
    """
    image = check_image(image)
    colors = load_colors("dice") if colors is None else colors
    of_kind(colors, ColorModel, "colors", ColorModelError, "tracker.load_colors")
    scale = min(image.shape[:2]) / REFERENCE_SIZE
    image, light = in_even_light(image, colors.normalise)
    gains = light.gains
    # Demosaicing leaves single wrong pixels at the finer resolution.
    fine = scale > FINE_IMAGE
    image = np.asarray(cv2.medianBlur(image, 3), dtype=np.uint8) if fine else calmed(image, gains)
    gain = gains[0] if colors.normalise else find_light(image).gains[0]

    inside, blue = np.empty(image.shape[:2], np.uint8), np.empty(image.shape[:2], np.uint8)
    ratio = np.empty(image.shape[:2], np.float32)
    ratios = np.log(np.outer(gains[[0, 2]], np.arange(256)) + OFFSET).astype(np.float32)
    channels = colors.channel_tables(gains)
    read_levels(image, channels, colors.margin_table, ratios, gains, gain, inside, ratio, blue)
    inside = np.asarray(cv2.medianBlur(inside, 3), dtype=np.uint8)
    mask: Image = np.zeros(image.shape[:2], np.uint8)
    left, top, width, height = cv2.boundingRect(inside)
    if width:
        margin = _odd(7 * scale)  # the mask grows by less
        rows = slice(max(top - margin, 0), top + height + margin)
        part = rows, slice(max(left - margin, 0), left + width + margin)
        own = np.ascontiguousarray
        mask[part] = _mask(own(image[part]), own(inside[part]), own(blue[part]), own(ratio[part]), scale)
    return mask


def _mask(image: Image, inside: Image, blue: Image, ratio: Array, scale: float) -> Image:
    """Return the mask (0, 255) grown from the inside."""
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
    """Return the inside pixels that are connected, within a few steps, to bright or wide parts."""
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
