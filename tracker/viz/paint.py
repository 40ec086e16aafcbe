"""Anti-aliased shapes and text: what OpenCV's drawing lacks for lines placed to a fraction of a pixel."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import cv2
import numpy as np

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
_FONT = cv2.FONT_HERSHEY_SIMPLEX
_DIGIT_WIDTH = 0.66  # of its height, in the font of OpenCV 5


def fill(image: Image, polygon: FloatArray, color: Sequence[int], opacity: float) -> None:
    """Blend a polygon (N, 2) [px] into the image."""

    def paint(mask: Image, shapes: list[Array]) -> None:
        cv2.fillPoly(mask, shapes, 255, cv2.LINE_8, _SHIFT)

    _blend(image, [polygon], color, opacity, 1.0, paint)


def stroke(
    image: Image, lines: Sequence[FloatArray], color: Sequence[int], width: float, opacity: float = 1.0
) -> None:
    """Blend open lines (N, 2) [px] of a width [px] into the image, as one: crossings are not darker."""

    def paint(mask: Image, shapes: list[Array]) -> None:
        cv2.polylines(mask, shapes, False, 255, max(1, round(width * _FINE)), cv2.LINE_8, _SHIFT)

    _blend(image, lines, color, opacity, width, paint)


def circle(center: FloatArray, radius: float) -> FloatArray:
    """A polygon (N, 2) [px] that looks like a circle; its last point is its first."""
    angles = np.linspace(0, 2 * np.pi, max(16, round(3 * radius)) + 1)
    return center + radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)


def text_width(text: str, size: float) -> float:
    """Width [px] of a line of text whose digits are about `size` [px] high."""
    (width, _), _ = cv2.getTextSize(text, _FONT, _scale(size), 1)
    return float(width)


def put_text(
    image: Image,
    text: str,
    at: tuple[float, float],
    color: Color,
    *,
    size: float,
    align: float = 0.0,
) -> None:
    """Write a line of text on the baseline through `at` [px], its left (align 0) … right (1) end there.

    Before OpenCV 5 only ASCII characters can be drawn.
    """
    left = at[0] - align * text_width(text, size)
    cv2.putText(image, text, (round(left), round(at[1])), _FONT, _scale(size), color, 1, cv2.LINE_AA)


def _scale(size: float) -> float:
    # OpenCV 5 draws outline fonts, OpenCV 4 wider strokes: make their digits equally wide.
    (width, _), _ = cv2.getTextSize("0123456789", _FONT, 10.0, 1)
    return 10.0 * 10 * _DIGIT_WIDTH * size / width


def _blend(
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
    part = image[low[1] : high[1], low[0] : high[0]]
    mask = np.zeros((part.shape[0] * _FINE, part.shape[1] * _FINE), np.uint8)
    paint(mask, [np.rint(((s - low + 0.5) * _FINE - 0.5) * 2**_SHIFT).astype(np.int32) for s in shapes])
    coverage = cv2.resize(mask, part.shape[1::-1], interpolation=cv2.INTER_AREA)
    weight = coverage[:, :, None] * (opacity / 255)
    part[:] = np.rint(part * (1 - weight) + np.asarray(color) * weight)
