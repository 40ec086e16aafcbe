"""The footer: small tables below the views."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from tracker.conventions import Image
from tracker.viz import paint

GOOD: paint.Color = (120, 200, 110)
DOUBTFUL: paint.Color = (80, 170, 245)
"""Colours of a block's last line that say how it went."""

_MARGIN, _LINE, _SPACE, _COLUMN = 24, 28, 50, 17
"""Around the strip, between lines, blocks, and a block's columns [px]; all grow with the strip."""
_SIZES = (10.0, 12.0, 12.0)
"""Heights of the digits in a block's lines [px]."""
_WIDTH, _MOST = 1000, 1.5
"""A strip wider than this [px] is written larger, up to so many times."""


@dataclass(frozen=True)
class Block:
    """A small table of three lines: headings, values and what qualifies them."""

    lines: tuple[list[str], list[str], list[str]]
    color: paint.Color = paint.FAINT
    """Of the last line."""

    def columns(self, scale: float) -> list[float]:
        """Widths [px]."""
        sized = zip(self.lines, _SIZES, strict=True)
        widths = [[paint.text_width(cell, size * scale) for cell in line] for line, size in sized]
        return [max(column) for column in zip(*widths, strict=True)]

    def width(self, scale: float) -> float:
        """Width [px]."""
        columns = self.columns(scale)
        return sum(columns) + _COLUMN * scale * (len(columns) - 1)

    def draw(self, strip: Image, left: float, top: float, scale: float) -> None:
        """Write the block with its upper left corner at (left, top) [px]; the first column is flush left."""
        styles = zip(self.lines, _SIZES, (paint.FAINT, paint.BRIGHT, self.color), strict=True)
        for row, (line, size, color) in enumerate(styles):
            x, y = left, top + (row * _LINE + _SIZES[0]) * scale
            for column, (cell, width) in enumerate(zip(line, self.columns(scale), strict=True)):
                align = 0.0 if column == 0 else 1.0
                paint.put_text(strip, cell, (x + align * width, y), color, size=size * scale, align=align)
                x += width + _COLUMN * scale


def footer(width: int, blocks: Iterable[Block]) -> Image:
    """A strip `width` [px] wide of blocks side by side, which wrap where it is narrow."""
    scale = float(np.clip(width / _WIDTH, 1.0, _MOST))
    margin, line, left, top = _MARGIN * scale, _LINE * scale, _MARGIN * scale, _MARGIN * scale
    places = []
    for block in blocks:
        if left > margin and left + block.width(scale) > width - margin:
            left, top = margin, top + 3 * line + margin / 2
        places.append((block, left, top))
        left += block.width(scale) + _SPACE * scale
    height = round(top + 2 * line + _SIZES[0] * scale + margin)
    picture: Image = np.full((height, width, 3), paint.BACKGROUND, np.uint8)
    for block, x, y in places:
        block.draw(picture, x, y, scale)
    return picture
