"""Anti-aliased shapes and text, blended into images.

Text is Pillow's, which looks alike with every OpenCV. Shapes are OpenCV's: on the same finer grid its lines
are off by 0.02 px (RMS), Pillow's, which has whole pixels only, by 0.17 px.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from PIL import Image as Pillow
from PIL import ImageDraw, ImageFont

from tracker.conventions import Array, FloatArray, Image

Color = tuple[int, int, int]
"""Blue, green, red."""

BACKGROUND: Color = (29, 24, 22)
BRIGHT: Color = (245, 243, 240)
FAINT: Color = (158, 148, 140)
WHITE: Color = (255, 255, 255)
BLACK: Color = (0, 0, 0)

_FINE = 4
"""Shapes are drawn on a grid this much finer, and averaged."""

_SHIFT = 4

# The font in Pillow has no umlauts.
_FONT = Path(__file__).parent / "fonts" / "DejaVuSansCondensed.ttf"
_EM = 1.15
"""A font's size, in heights of its digits."""


def fill(image: Image, polygon: FloatArray, color: Sequence[int], opacity: float) -> None:
    """Blend a polygon (N, 2) [px] into the image."""

    def paint(mask: Image, shapes: list[Array]) -> None:
        cv2.fillPoly(mask, shapes, 255, cv2.LINE_8, _SHIFT)

    _draw(image, [polygon], color, opacity, 1.0, paint)


def stroke(
    image: Image, lines: Sequence[FloatArray], color: Sequence[int], width: float, opacity: float = 1.0
) -> None:
    """Blend open lines (N, 2) [px] of a width [px] into the image, as one: crossings are not darker."""

    def paint(mask: Image, shapes: list[Array]) -> None:
        cv2.polylines(mask, shapes, False, 255, max(1, round(width * _FINE)), cv2.LINE_8, _SHIFT)

    _draw(image, lines, color, opacity, width, paint)


def circle(center: FloatArray, radius: float) -> FloatArray:
    """A polygon (N, 2) [px] that looks like a circle; its last point is its first."""
    angles = np.linspace(0, 2 * np.pi, max(16, round(3 * radius)) + 1)
    return center + radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)


def text_width(text: str, size: float) -> float:
    """Width [px] of a line of text whose digits are about `size` [px] high."""
    return _font(size).getlength(text)


def put_text(
    image: Image,
    text: str,
    at: tuple[float, float],
    color: Color,
    *,
    size: float,
    align: float = 0.0,
) -> None:
    """Write a line of text on the baseline through `at` [px], its left (align 0) … right (1) end there."""
    font = _font(size)
    left, top, right, bottom = (round(side) for side in font.getbbox(text, anchor="ls"))
    mask = Pillow.new("L", (right - left + 2, bottom - top + 2))
    ImageDraw.Draw(mask).text((1 - left, 1 - top), text, fill=255, font=font, anchor="ls")
    start = round(at[0] - align * font.getlength(text)) + left - 1, round(at[1]) + top - 1
    _blend(image, np.asarray(mask), start, color, 1.0)


@lru_cache
def _font(size: float) -> ImageFont.FreeTypeFont:
    # The basic layout is there with every Pillow, and equal.
    return ImageFont.truetype(str(_FONT), _EM * size, layout_engine=ImageFont.Layout.BASIC)


def _draw(
    image: Image,
    shapes: Sequence[FloatArray],
    color: Sequence[int],
    opacity: float,
    margin: float,
    paint: Callable[[Image, list[Array]], Any],
) -> None:
    """Blend what `paint` draws, on a finer grid of the part of the image that holds the shapes."""
    if not shapes:
        return
    points = np.concatenate(shapes)
    low = np.maximum(np.floor(points.min(axis=0) - margin - 1), 0).astype(int)
    high = np.minimum(np.ceil(points.max(axis=0) + margin + 2), image.shape[1::-1]).astype(int)
    if (low >= high).any():
        return
    width, height = high - low
    mask = np.zeros((height * _FINE, width * _FINE), np.uint8)
    paint(mask, [np.rint(((s - low + 0.5) * _FINE - 0.5) * 2**_SHIFT).astype(np.int32) for s in shapes])
    coverage = np.asarray(cv2.resize(mask, (width, height), interpolation=cv2.INTER_AREA), np.uint8)
    _blend(image, coverage, (low[0], low[1]), color, opacity)


def _blend(
    image: Image, coverage: Image, start: tuple[int, int], color: Sequence[int], opacity: float
) -> None:
    """Blend a colour into the image, whose pixel `start` (column, row) is the coverage's (H, W) first."""
    (left, top), (height, width) = start, coverage.shape
    part = image[max(top, 0) : max(top + height, 0), max(left, 0) : max(left + width, 0)]
    inside = coverage[max(-top, 0) :, max(-left, 0) :][: part.shape[0], : part.shape[1]]
    weight = inside[:, :, None] * (opacity / 255)
    part[:] = np.rint(part * (1 - weight) + np.asarray(color) * weight)
