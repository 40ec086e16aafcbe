"""Why no board was found in a photo: what is tried, and what is said."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
from typing import Any

import cv2
import numpy as np

from tracker.calibration.board import Board
from tracker.calibration.board_sighting import FEWEST_CORNERS, find_board, grey
from tracker.conventions import Array, FloatArray, Image
from tracker.errors import CalibrationError

MOST_BLUR = 1.5
"""Standard deviation [px] of the blur above which markers are lost and corners drift."""

_LARGEST = 16
"""Boards of up to so many squares along an edge are tried."""

_AGREE = 0.3
"""Farthest that a marker's corner may be from where the others put it [edges of its marker]."""

_FEWEST_MARKERS = 4


def why_no_board(image: Image, board: Board) -> str:
    """What is wrong with an image (H, W, 3) or (H, W) in which `find_board` finds nothing, in few words."""
    gray = grey(image)
    if find_board("", np.ascontiguousarray(gray[:, ::-1]), board) is not None:
        return "the photo is mirrored"
    other = other_size(gray, board)
    if other is not None:
        return f"its markers lie as on a board of {other} squares, expected {board.columns}x{board.rows}"
    blur = photo_blur(gray)
    if blur > MOST_BLUR:
        return f"the photo is blurred, its sharpest edges by {blur:.1f} px"
    count = len(_markers(gray, board)[1])
    if count:
        return f"only {count} markers of {board.dictionary} found, no {FEWEST_CORNERS} corners between them"
    return f"no marker of {board.dictionary} found"


def other_size(gray: Image, board: Board) -> str | None:
    """The smallest other board on which more of the markers in an image (H, W) lie as they are seen.

    Returns:
        Its columns and rows, e.g. "5x7", or None where the expected board explains as many.
    """
    corners, numbers = _markers(gray, board)
    if len(numbers) < _FEWEST_MARKERS:
        return None
    mine = _agreeing(corners, numbers, board)
    if mine == len(numbers):
        return None
    best, best_count = None, max(mine, _FEWEST_MARKERS - 1)
    for tried in _candidates(board):
        count = _agreeing(corners, numbers, tried)
        if count > best_count:
            best, best_count = f"{tried.columns}x{tried.rows}", count
    return best


@functools.lru_cache(maxsize=8)
def _candidates(board: Board) -> tuple[Board, ...]:
    """Boards of other sizes with the same markers, the smallest first."""
    sizes = [(columns, rows) for columns in range(3, _LARGEST) for rows in range(3, _LARGEST)]
    boards = []
    for columns, rows in sorted(sizes, key=lambda size: size[0] * size[1]):
        for legacy in (False, True) if rows % 2 == 0 else (False,):
            # Larger ones need more markers than the dictionary has.
            with contextlib.suppress(CalibrationError):
                boards.append(dataclasses.replace(board, columns=columns, rows=rows, legacy=legacy))
    return tuple(boards)


def require_size(photo: str, image: Image, board: Board) -> None:
    """Refuse a board that is only part of the one in an image, or has its markers elsewhere.

    Raises:
        CalibrationError: the message says the size of the board in the image.
    """
    other = other_size(grey(image), board)
    if other is not None:
        raise CalibrationError(
            f"{photo}: its markers lie as on a board of {other} squares, expected "
            f"{board.columns}x{board.rows}"
        )


def photo_blur(gray: Image) -> float:
    """Blur [px] of the strongest edges of an image (H, W), whatever it shows; NaN where it shows none.

    An edge of blur σ loses its slope by the factor σ/√(σ² + s²) where the image is blurred by s more
    (Zhuo and Sim, Defocus map estimation from a single image, 2011). Of rows and columns, which motion
    blurs differently, the greater.
    """
    image = gray.astype(np.float32)
    return max(_blur_along_rows(image), _blur_along_rows(np.ascontiguousarray(image.T)))


def _blur_along_rows(image: Array) -> float:
    more = 2.0
    slope = np.abs(np.gradient(image, axis=1))
    strong = slope >= max(float(np.quantile(slope, 0.995)), 1.0)
    if not strong.any():
        return float("nan")
    again = cv2.GaussianBlur(image, (0, 1), more, sigmaY=1e-6)
    slope_again = np.abs(np.gradient(again, axis=1))
    ratio = float(np.median(slope[strong] / np.maximum(slope_again[strong], 1e-6)))
    return more / float(np.sqrt(max(ratio**2 - 1, 1e-6)))


def _markers(gray: Image, board: Board) -> tuple[FloatArray, Array]:
    """Corners (N, 4, 2) [px] and numbers (N,) of all markers in an image."""
    found: Any = cv2.aruco.ArucoDetector(board.markers).detectMarkers(gray)
    corners, numbers = found[:2]
    if numbers is None:
        return np.zeros((0, 4, 2)), np.zeros(0, int)
    return np.asarray(corners, np.float64).reshape(-1, 4, 2), np.asarray(numbers).ravel()


@functools.lru_cache(maxsize=512)
def _places(board: Board) -> dict[int, FloatArray]:
    """Corners (4, 2) of each marker on the board [m]."""
    points = np.asarray(board.opencv.getObjPoints(), np.float64)[:, :, :2]
    return dict(zip(board.opencv.getIds().ravel().tolist(), points, strict=True))


def _agreeing(corners: FloatArray, numbers: Array, board: Board) -> int:
    """How many of the markers lie as on the board, seen through the homography that most agree with."""
    places = _places(board)
    known = np.array([number in places for number in numbers], bool)
    if known.sum() < _FEWEST_MARKERS:
        return 0
    seen = corners[known]
    plane = np.array([places[number] for number in numbers[known]])
    edge = float(np.median(np.linalg.norm(np.diff(seen, axis=1), axis=2)))
    pairs = plane.reshape(-1, 2), seen.reshape(-1, 2)
    fitted: Any = cv2.findHomography(*pairs, cv2.RANSAC, _AGREE * edge, maxIters=200)
    matrix = fitted[0]
    if matrix is None:
        return 0
    mapped = cv2.perspectiveTransform(plane.reshape(-1, 1, 2), matrix).reshape(-1, 4, 2)
    distance = np.linalg.norm(mapped - seen, axis=2).max(axis=1)
    return int((distance < _AGREE * edge).sum())
