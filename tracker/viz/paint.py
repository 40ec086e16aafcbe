"""Blend anti-aliased shapes and text into images.

Text is drawn by Pillow, so that it looks the same with any version of OpenCV. Shapes are drawn by OpenCV: on
the same fine grid its lines are off by 0.02 px (RMS); Pillow's, limited to whole pixels, by 0.17 px.
"""

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
from PIL import Image as Pillow
from PIL import ImageDraw, ImageFont

from tracker.conventions import Array, FloatArray, Image

Color = tuple[int, int, int]  # blue, green, red

BACKGROUND: Color = (29, 24, 22)
BRIGHT: Color = (245, 243, 240)
FAINT: Color = (158, 148, 140)
WHITE: Color = (255, 255, 255)
BLACK: Color = (0, 0, 0)

_FINE = 4  # oversampling: shapes are drawn on a grid this much finer, then averaged
_SHIFT = 4
"""Fractional bits of OpenCV's polygon corners."""

# Pillow's built-in font has no umlauts.
_FONT = Path(__file__).parent / "fonts" / "DejaVuSansCondensed.ttf"
_EM = 1.15  # font size [digit heights]


def canvas(width: int, height: int, color: Color = BACKGROUND) -> Image:
    """Return an empty image of a given size [px]."""
    return np.full((height, width, 3), color, np.uint8)


def fill(image: Image, polygon: FloatArray, color: Sequence[int], opacity: float) -> None:
    """Blend a polygon (N, 2) [px] into the image."""
    stroke(image, [polygon], color, None, opacity)


def stroke(
    image: Image, lines: Sequence[FloatArray], color: Sequence[int], width: float | None, opacity: float = 1.0
) -> None:
    """Blend open lines (N, 2) [px] of a given width [px] into the image at once: crossings are not darker.

    If `width` is None, they are the borders of filled polygons.
    """
    if not lines:
        return
    points, margin = np.concatenate(lines), width or 1.0
    low = np.maximum(np.floor(points.min(axis=0) - margin - 1), 0).astype(int)
    high = np.minimum(np.ceil(points.max(axis=0) + margin + 2), image.shape[1::-1]).astype(int)
    if (low >= high).any():
        return
    part = image[low[1] : high[1], low[0] : high[0]]
    mask = np.zeros((part.shape[0] * _FINE, part.shape[1] * _FINE), np.uint8)
    fine = [np.rint(((line - low + 0.5) * _FINE - 0.5) * 2**_SHIFT).astype(np.int32) for line in lines]
    if width is None:
        cv2.fillPoly(mask, fine, 255, cv2.LINE_8, _SHIFT)
    else:
        cv2.polylines(mask, fine, False, 255, max(1, round(width * _FINE)), cv2.LINE_8, _SHIFT)
    blend(part, cv2.resize(mask, part.shape[1::-1], interpolation=cv2.INTER_AREA), color, opacity)


def circle(center: FloatArray, radius: float) -> FloatArray:
    """Return a polygon (N, 2) [px] that approximates a circle; its last point is its first."""
    angles = np.linspace(0, 2 * np.pi, max(16, round(3 * radius)) + 1)
    return center + radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)


def text_width(text: str, size: float) -> float:
    """Return the width [px] of a line of text whose digits are about `size` [px] high."""
    return _font(size).getlength(text)


def put_text(
    image: Image, text: str, at: tuple[float, float], color: Color, *, size: float, align: float = 0.0
) -> None:
    """Write a line of text; `at` [px] is the left (align 0) … right (align 1) end of its baseline."""
    left, base = round(at[0] - align * text_width(text, size)), round(at[1])
    top = max(base - round(2 * size), 0)
    # Pillow draws into a copy, so pass only the rows that the text can reach. It takes blue for red, but in
    # both image and colour.
    rows = image[top : max(base + round(size), 0)]
    if not rows.size:
        return
    canvas = Pillow.fromarray(rows)
    ImageDraw.Draw(canvas).text((left, base - top), text, color, _font(size), anchor="ls")
    rows[:] = np.asarray(canvas)


@lru_cache
def _font(size: float) -> ImageFont.FreeTypeFont:
    # The basic layout is in every Pillow, and gives the same result everywhere.
    return ImageFont.truetype(str(_FONT), _EM * size, layout_engine=ImageFont.Layout.BASIC)


def blend(image: Image, coverage: Array, color: Sequence[int], opacity: float) -> None:
    """Blend a colour into the image in proportion to a coverage (H, W) from 0 to 255."""
    weight = coverage[:, :, None] * (opacity / 255)
    image[:] = np.rint(image * (1 - weight) + np.asarray(color) * weight)
