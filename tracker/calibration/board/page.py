"""The board on a page, to print at its true size: PDF, SVG and PNG of its picture at 600 dots per inch.

A dot is 0.04 mm, and every square begins at the nearest one: the error does not add up along the board.
"""

from __future__ import annotations

import base64
import dataclasses
import io

import numpy as np
from PIL import Image as Pillow
from PIL import ImageDraw, ImageFont

from tracker.calibration.board.board import Board
from tracker.conventions import Image
from tracker.errors import CalibrationError

PAGES = {"A4": (210.0, 297.0), "A3": (297.0, 420.0), "A2": (420.0, 594.0), "A1": (594.0, 841.0)}
"""Width and height [mm] of pages, the smallest first."""

_DOTS, _LARGE_DOTS = 600, 300
"""Per inch; of a page beyond A1, which would need a gigabyte, fewer."""

_LEAST_MARGIN = 4.0
_LARGEST = 1200.0
"""Longest edge [mm] of a board without a page of a standard size."""

_TEXT = 2.5
"""Height of the text [mm]."""


@dataclasses.dataclass(frozen=True)
class Page:
    """A board in the middle of a page."""

    board: Board
    width: float
    """[mm]"""
    height: float
    """[mm]"""

    @property
    def origin(self) -> tuple[float, float]:
        """The board's left and top edge on the page [mm]."""
        across, down = (1000 * size for size in self.board.size)
        return (self.width - across) / 2, (self.height - down) / 2


def page_of(board: Board) -> Page:
    """The smallest page of PAGES, upright or lying, that holds the board; else one as large as it needs.

    Raises:
        CalibrationError: the board is larger than what is printed.
    """
    across, down = (1000 * size for size in board.size)
    for width, height in PAGES.values():
        for page in ((width, height), (height, width)):
            if across + 2 * _LEAST_MARGIN <= page[0] and down + 2 * _LEAST_MARGIN <= page[1]:
                return Page(board, *page)
    if max(across, down) > _LARGEST:
        raise CalibrationError(
            f"board: found {across:g}x{down:g} mm, expected at most {_LARGEST:g} mm to print; "
            "lengths are given in metres"
        )
    return Page(board, across + 20, down + 20)


def page_image(page: Page, dots: float) -> Image:
    """(H, W) the page without its text at a number of dots per inch."""
    scale = dots / 25.4
    image = np.full((round(page.height * scale), round(page.width * scale)), 255, np.uint8)
    left, top = (round(edge * scale) for edge in page.origin)
    across, down = (round(1000 * size * scale) for size in page.board.size)
    image[top : top + down, left : left + across] = page.board.opencv.generateImage((across, down))
    return image


def printed(page: Page, suffix: str) -> bytes:
    """The page as a file: .pdf, .svg or .png."""
    dots = _DOTS if page.width * page.height <= np.prod(PAGES["A1"]) else _LARGE_DOTS
    image = Pillow.fromarray(page_image(page, dots)).convert("1")
    scale = dots / 25.4
    font = ImageFont.load_default(_TEXT * scale)
    text = f"{page.board}; print at 100 %"
    ImageDraw.Draw(image).text(
        (page.origin[0] * scale, (page.height - 1.5) * scale), text, fill=0, font=font, anchor="ls"
    )
    out = io.BytesIO()
    if suffix == ".pdf":
        image.save(out, "PDF", resolution=dots)
        return out.getvalue()
    image.save(out, "PNG", dpi=(dots, dots))
    if suffix == ".png":
        return out.getvalue()
    size = f'width="{page.width}mm" height="{page.height}mm"'
    content = base64.b64encode(out.getvalue()).decode()
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" {size} viewBox="0 0 {page.width} {page.height}">'
        f'<image width="{page.width}" height="{page.height}" href="data:image/png;base64,{content}"/></svg>\n'
    ).encode()
