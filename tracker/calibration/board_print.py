"""The board as a page to print at its true size: PDF and SVG of exact rectangles, PNG with its resolution."""

from __future__ import annotations

import dataclasses
import struct
import zlib
from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np

from tracker.calibration.board import Board
from tracker.conventions import Image
from tracker.errors import CalibrationError

PAGES = {"A4": (210.0, 297.0), "A3": (297.0, 420.0), "A2": (420.0, 594.0), "A1": (594.0, 841.0)}
"""Width and height [mm] of pages, the smallest first."""

SUFFIXES = (".pdf", ".svg", ".png")
"""Formats of `printed`."""

_POINT = 72 / 25.4
_DOTS = 600
"""Of a PNG, per inch."""

_LEAST_MARGIN = 4.0
_LARGEST = 1200.0
"""Longest edge [mm] of a board without a page of a standard size."""

_TEXT = 2.5
"""Height of the text [mm]."""

Rectangle = tuple[float, float, float, float]
"""Left, top, width and height [mm], from the top left."""


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

    @property
    def text(self) -> str:
        """What stands below the board."""
        return f"{self.board}; print at 100 %"


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


def black(board: Board) -> Iterator[Rectangle]:
    """The board's black rectangles [mm], from its top left: squares, and the markers' bits row by row."""
    edge, marker = 1000 * board.square, 1000 * board.marker
    inset = (edge - marker) / 2
    numbers = iter(board.opencv.getIds().ravel().tolist())
    first = 1 if board.two_patterns and board.legacy else 0
    for row in range(board.rows):
        for column in range(board.columns):
            left, top = column * edge, row * edge
            if (row + column + first) % 2 == 0:
                yield left, top, edge, edge
            else:
                for x, y, width, height in _marker(board, next(numbers)):
                    yield left + inset + x * marker, top + inset + y * marker, width * marker, height * marker


def _marker(board: Board, number: int) -> Iterator[Rectangle]:
    """Black runs of a marker [its edge]."""
    markers = board.markers
    cells = int(markers.markerSize) + 2  # with its border, one cell wide
    bits = np.asarray(cv2.aruco.generateImageMarker(markers, int(number), cells))
    for row in range(cells):
        edges = np.flatnonzero(np.diff(np.concatenate([[0], (bits[row] == 0).astype(int), [0]])))
        for start, end in edges.reshape(-1, 2).tolist():
            yield start / cells, row / cells, (end - start) / cells, 1 / cells


def printed(page: Page, suffix: str) -> bytes:
    """The page as a file of a format of SUFFIXES."""
    return {".pdf": _pdf, ".svg": _svg, ".png": _png}[suffix](page)


def _svg(page: Page) -> bytes:
    left, top = page.origin
    boxes = "".join(
        f"M{left + x:.5f} {top + y:.5f}h{w:.5f}v{h:.5f}h{-w:.5f}z" for x, y, w, h in black(page.board)
    )
    text = (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{page.width}mm" height="{page.height}mm" '
        f'viewBox="0 0 {page.width} {page.height}"><rect width="100%" height="100%" fill="#fff"/>'
        f'<path d="{boxes}"/><text x="{left}" y="{page.height - 1.5}" font-family="sans-serif" '
        f'font-size="{_TEXT}">{page.text}</text></svg>\n'
    )
    return text.encode()


def _pdf(page: Page) -> bytes:
    """A PDF 1.4 of one page; its units are points, from the bottom left."""
    left, top = page.origin
    parts = [f"{_POINT:.9f} 0 0 {-_POINT:.9f} 0 {page.height * _POINT:.6f} cm"]
    parts += [f"{left + x:.5f} {top + y:.5f} {w:.5f} {h:.5f} re" for x, y, w, h in black(page.board)]
    parts.append(f"f BT /F {_TEXT} Tf 1 0 0 -1 {left:.3f} {page.height - 1.5:.3f} Tm ({page.text}) Tj ET")
    drawing = "\n".join(parts).encode("latin-1")
    box = f"0 0 {page.width * _POINT:.4f} {page.height * _POINT:.4f}"
    objects = [
        b"<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>",
        b"<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
        f"<< /Type /Page /Parent 2 0 R /MediaBox [{box}] /Contents 4 0 R "
        "/Resources << /Font << /F 5 0 R >> >> >>".encode(),
        b"<< /Length %d >>\nstream\n%s\nendstream" % (len(drawing), drawing),
        b"<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica >>",
    ]
    out, places = b"%PDF-1.4\n", []
    for number, content in enumerate(objects, 1):
        places.append(len(out))
        out += b"%d 0 obj\n%s\nendobj\n" % (number, content)
    table = b"".join(b"%010d 00000 n \n" % place for place in places)
    end = b"trailer << /Size %d /Root 1 0 R >>\nstartxref\n%d\n%%%%EOF\n" % (len(objects) + 1, len(out))
    return out + b"xref\n0 %d\n0000000000 65535 f \n" % (len(objects) + 1) + table + end


def page_image(page: Page, dots: float) -> Image:
    """(H, W) the page at a number of dots per inch."""
    scale = dots / 25.4
    image = np.full((round(page.height * scale), round(page.width * scale)), 255, np.uint8)
    left, top = page.origin
    for x, y, width, height in black(page.board):
        across = [round((left + at) * scale) for at in (x, x + width)]
        down = [round((top + at) * scale) for at in (y, y + height)]
        image[down[0] : down[1], across[0] : across[1]] = 0
    return image


def _png(page: Page) -> bytes:
    content = cv2.imencode(".png", page_image(page, _DOTS))[1].tobytes()
    per_metre = round(_DOTS / 0.0254)
    body = b"pHYs" + struct.pack(">IIB", per_metre, per_metre, 1)
    chunk: Any = struct.pack(">I", len(body) - 4) + body + struct.pack(">I", zlib.crc32(body))
    header = 8 + 25  # signature and IHDR; the resolution has to stand before the pixels
    return content[:header] + bytes(chunk) + content[header:]
