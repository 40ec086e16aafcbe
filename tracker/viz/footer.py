"""The footer: small tables below the views, such as an observation's numbers."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from tracker.conventions import Array, Image
from tracker.pose.result import Observation, PoseEstimate
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


class Block(NamedTuple):
    """A small table of three lines: headings, values and what qualifies them."""

    lines: tuple[list[str], list[str], list[str]]
    color: paint.Color = paint.FAINT
    """Of the last line."""


def footer(width: int, blocks: Iterable[Block]) -> Image:
    """A strip `width` [px] wide of blocks side by side, which wrap where it is narrow.

    The first column of a block is flush left, others flush right.
    """
    scale = float(np.clip(width / _WIDTH, 1.0, _MOST))
    sizes = [size * scale for size in _SIZES]
    margin, line, between = _MARGIN * scale, _LINE * scale, _COLUMN * scale
    left = top = margin
    cells = []
    for block in blocks:
        sized = [[(text, size) for text in texts] for texts, size in zip(block.lines, sizes, strict=True)]
        widths = [max(paint.text_width(*cell) for cell in column) for column in zip(*sized, strict=True)]
        whole = sum(widths) + between * (len(widths) - 1)
        if left > margin and left + whole > width - margin:
            left, top = margin, top + 3 * line + margin / 2
        for row, color in enumerate((paint.FAINT, paint.BRIGHT, block.color)):
            starts = left + np.cumsum([0.0, *widths[:-1]]) + between * np.arange(len(widths))
            ends = [starts[0], *(starts + widths)[1:]]
            for column, (text, size) in enumerate(sized[row]):
                at = float(ends[column]), top + row * line + sizes[0]
                cells.append((text, at, color, size, float(column > 0)))
        left += whole + _SPACE * scale
    height = round(top + 2 * line + sizes[0] + margin)
    picture: Image = np.full((height, width, 3), paint.BACKGROUND, np.uint8)
    for text, at, color, size, align in cells:
        paint.put_text(picture, text, at, color, size=size, align=align)
    return picture


def caption(name: str, observation: Observation, title: str) -> Iterable[Block]:
    """Blocks of object, status and the pose's numbers; `title` stands above the object's name."""
    measured, filtered = observation.object_pose, observation.filtered_object_pose
    pose, status = filtered if measured is None else measured, observation.status.value
    said = status if measured is not None else f"{'no pose' if pose is None else 'predicted'}: {status}"
    yield Block(([title or "object"], [name], [said]), DOUBTFUL if measured is None else GOOD)
    if pose is not None:
        yield from _pose_blocks(pose)


def _pose_blocks(pose: PoseEstimate) -> Iterable[Block]:
    std = np.sqrt(np.diag(pose.covariance))
    yield Block(
        (
            ["position", "x", "y", "z", ""],
            ["", *_numbers(1e3 * pose.position, 2), "mm"],
            ["std", *_numbers(1e3 * std[:3], 2), "mm"],
        )
    )
    yield Block(
        (
            ["orientation", "x", "y", "z", "w"],
            ["", *_numbers(pose.orientation, 4)],
            ["std", *(f"{value}°" for value in _numbers(np.degrees(std[3:]), 2)), ""],
        )
    )
    yield Block((["confidence"], [f"{pose.confidence:.3f}"], ["within 5 mm, 5°"]))


def _numbers(values: Array, digits: int) -> list[str]:
    return [f"{value:.{digits}f}".replace("-", "−") for value in values]
