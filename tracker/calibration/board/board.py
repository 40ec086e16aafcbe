"""The ChArUco board: a chessboard whose white squares hold markers, each of which says which it is.

Board frame: origin at the board's centre, x to the right and y upwards as the board is printed, z out of
the print. Corners are the inner ones of the chessboard; number 0 is at the top left, counted along rows.

Of boards with an even number of rows there are two patterns: today's begin with a black square at the top
left, those that OpenCV printed before its version 4.6 (`legacy`) with a marker. With an odd number both
are the same.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from typing import Any

import cv2
import numpy as np

from tracker.conventions import FloatArray
from tracker.errors import CalibrationError

MOST_SQUARES = 60
"""Squares along an edge; more are not seen as squares by any camera of the platform."""


def dictionaries() -> tuple[str, ...]:
    """Names of the sets of markers that OpenCV knows, e.g. `DICT_APRILTAG_16h5`."""
    return tuple(sorted(name for name in dir(cv2.aruco) if name.startswith("DICT_")))


@dataclasses.dataclass(frozen=True)
class Board:
    """A board of `columns` × `rows` squares.

    Raises:
        CalibrationError: there is no such board.
    """

    columns: int
    rows: int
    square: float
    """Edge of a square [m]."""
    marker: float
    """Edge of a marker [m]."""
    dictionary: str = "DICT_APRILTAG_16h5"
    """Name of the set of markers, see `dictionaries`."""
    legacy: bool = False
    """Whether a board with an even number of rows begins with a marker."""

    def __post_init__(self) -> None:
        if not (3 <= self.columns <= MOST_SQUARES and 3 <= self.rows <= MOST_SQUARES):
            found = f"{self.columns}x{self.rows} squares"
            raise CalibrationError(f"board: found {found}, expected 3 to {MOST_SQUARES} along each edge")
        if not (math.isfinite(self.square) and 0 < self.square <= 10):
            raise CalibrationError(f"board: found squares of {self.square:g} m, expected above 0, at most 10")
        if not 0 < self.marker < self.square:
            raise CalibrationError(
                f"board: found markers of {self.marker:g} m, expected less than the squares' {self.square:g}"
            )
        if self.dictionary not in dictionaries():
            known = ", ".join(dictionaries())
            raise CalibrationError(
                f"board: found the dictionary {self.dictionary!r}, expected one of {known}"
            )
        there, needed = len(self.markers.bytesList), self.columns * self.rows // 2
        if needed > there:
            raise CalibrationError(
                f"board: {self.columns}x{self.rows} squares need {needed} markers, "
                f"but {self.dictionary} has {there}"
            )

    def __str__(self) -> str:
        return (
            f"{self.columns}x{self.rows} squares of {self.square * 1000:g} mm, "
            f"markers of {self.marker * 1000:g} mm, {self.dictionary}"
            f"{', old pattern' if self.two_patterns and self.legacy else ''}"
        )

    @property
    def markers(self) -> Any:
        """OpenCV's dictionary."""
        return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))

    @property
    def two_patterns(self) -> bool:
        """Whether the old pattern differs from today's."""
        return self.rows % 2 == 0

    @functools.cached_property
    def opencv(self) -> Any:
        """OpenCV's board, whose frame begins at the top left, with y downwards and z into the print."""
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
        """(N, 3) inner corners in the board's frame [m]."""
        rows, columns = np.mgrid[1 : self.rows, 1 : self.columns]
        across, up = columns - self.columns / 2, self.rows / 2 - rows
        points: FloatArray = np.stack([across, up, np.zeros(across.shape)], axis=-1).reshape(-1, 3)
        return points * self.square

    def with_pattern(self, legacy: bool) -> Board:
        """The same board in the old pattern, or in today's."""
        return dataclasses.replace(self, legacy=legacy)
