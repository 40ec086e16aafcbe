"""The ChArUco board, a chessboard with numbered markers in its white squares, and the page to print.

Board frame: origin at the board's centre, x to the right and y upwards as the board is printed, z out of
the print. Corners are the inner corners of the chessboard, numbered row by row from 0 at the top left.

Boards with an even number of rows exist in two patterns: current ones begin with a black square at the top
left, those printed by OpenCV before version 4.6 (`legacy`) with a marker. With an odd number of rows both
patterns are the same.

Pages are PDF, SVG or PNG files of an image at 600 dots per inch. A dot is 0.04 mm, and every square begins at
the nearest dot, so rounding errors do not add up along the board.
"""

import base64
import dataclasses
import functools
import io
from typing import Any

import cv2
import numpy as np
from PIL import Image as Pillow
from PIL import ImageDraw, ImageFont

from tracker.conventions import FloatArray, Image
from tracker.errors import CalibrationError

MOST_SQUARES = 60
"""Largest number of squares along an edge; the platform's cameras cannot resolve more."""


@dataclasses.dataclass(frozen=True)
class Board:
    """A board of `columns` × `rows` squares; CalibrationError if such a board is impossible."""

    columns: int
    rows: int
    square: float
    """Edge of a square [m]."""
    marker: float
    """Edge of a marker [m]."""
    dictionary: str = "DICT_APRILTAG_16h5"
    """OpenCV's name of the marker dictionary."""
    legacy: bool = False
    """Whether a board with an even number of rows begins with a marker (the old pattern)."""

    def __post_init__(self) -> None:
        squares, square = f"{self.columns}x{self.rows} squares", self.square
        known = sorted(name for name in dir(cv2.aruco) if name.startswith("DICT_"))
        least, most = 0.2 * square, 0.95 * square  # a white gap is left around each marker
        sizes = all(3 <= count <= MOST_SQUARES for count in (self.columns, self.rows))
        for holds, found, valid in (
            (sizes, squares, f"3 to {MOST_SQUARES} along each edge"),
            (0.002 <= square <= 1, f"squares of {square:g} m", "at least 0.002, at most 1 m"),
            (
                least <= self.marker <= most,
                f"markers of {self.marker:g} m",
                f"from {least:g} to {most:g}, less than the squares' {square:g}",
            ),
            (self.dictionary in known, f"the dictionary {self.dictionary!r}", f"one of {', '.join(known)}"),
        ):
            if not holds:
                raise CalibrationError(f"board: found {found}, expected {valid}")
        there, needed = len(self.markers.bytesList), self.columns * self.rows // 2
        if needed > there:
            raise CalibrationError(
                f"board: {squares} need {needed} markers, but {self.dictionary} has {there}"
            )

    def __str__(self) -> str:
        return (
            f"{self.columns}x{self.rows} squares of {self.square * 1000:g} mm, "
            f"markers of {self.marker * 1000:g} mm, {self.dictionary}"
            f"{', old pattern' if self.two_patterns and self.legacy else ''}"
        )

    @property
    def markers(self) -> Any:
        """OpenCV's marker dictionary."""
        return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))

    @property
    def two_patterns(self) -> bool:
        """Whether the old pattern differs from the current one."""
        return self.rows % 2 == 0

    @functools.cached_property
    def opencv(self) -> Any:
        """OpenCV's board, whose frame has its origin at the top left, y downwards and z into the print."""
        board = cv2.aruco.CharucoBoard(
            (self.columns, self.rows), float(self.square), float(self.marker), self.markers
        )
        board.setLegacyPattern(self.legacy)
        return board

    @property
    def size(self) -> tuple[float, float]:
        """Width and height [m]."""
        return self.columns * self.square, self.rows * self.square

    @functools.cached_property
    def corners(self) -> FloatArray:
        """Positions (N, 3) of the inner corners in the board's frame [m]."""
        rows, columns = np.mgrid[1 : self.rows, 1 : self.columns].reshape(2, -1)
        across, up = columns - self.columns / 2, self.rows / 2 - rows
        return np.stack([across, up, np.zeros(len(up))], axis=-1) * self.square


PAGES = {"A4": (210.0, 297.0), "A3": (297.0, 420.0), "A2": (420.0, 594.0), "A1": (594.0, 841.0)}
"""Width and height [mm] of standard pages, the smallest first."""

_DOTS, _LARGE_DOTS = 600, 300
"""Resolution of pages [dots per inch]; lower for pages above A1, which would need a gigabyte."""

_LEAST_MARGIN, _TEXT = 4.0, 2.5
"""Smallest distance of a board from the page's edges, and height of the text [mm]."""

_LARGEST = 1200.0
"""Longest valid edge [mm] of a board that fits on no standard page."""


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
        """Position of the board's left and top edges on the page [mm]."""
        across, down = (1000 * size for size in self.board.size)
        return (self.width - across) / 2, (self.height - down) / 2


def page_of(board: Board) -> Page:
    """Return the smallest page of PAGES, portrait or landscape, that holds the board; else a custom one.

    CalibrationError: the board is too large to print.
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
    """Return the page without its text as an image (H, W) at a resolution of `dots` per inch."""
    scale = dots / 25.4
    image = np.full((round(page.height * scale), round(page.width * scale)), 255, np.uint8)
    left, top = (round(edge * scale) for edge in page.origin)
    across, down = (round(1000 * size * scale) for size in page.board.size)
    image[top : top + down, left : left + across] = page.board.opencv.generateImage((across, down))
    return image


def printed(page: Page, suffix: str) -> bytes:
    """Return the content of the page's file: .pdf, .svg or .png."""
    dots = _DOTS if page.width * page.height <= np.prod(PAGES["A1"]) else _LARGE_DOTS
    image = Pillow.fromarray(page_image(page, dots)).convert("1")
    scale = dots / 25.4
    font = ImageFont.load_default(_TEXT * scale)
    text = f"{page.board}; print at 100 %"
    ImageDraw.Draw(image).text(
        (page.origin[0] * scale, (page.height - 1.5) * scale), text, fill=0, font=font, anchor="ls"
    )
    out = io.BytesIO()
    image.save(out, "PDF" if suffix == ".pdf" else "PNG", resolution=dots, dpi=(dots, dots))
    if suffix != ".svg":
        return out.getvalue()
    size = f'width="{page.width}mm" height="{page.height}mm"'
    content = base64.b64encode(out.getvalue()).decode()
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" {size} viewBox="0 0 {page.width} {page.height}">'
        f'<image width="{page.width}" height="{page.height}" href="data:image/png;base64,{content}"/></svg>\n'
    ).encode()
