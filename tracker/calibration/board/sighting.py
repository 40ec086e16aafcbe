"""Detect a board in a photo: its pose, its corners and their sharpness; or say why none was found."""

from __future__ import annotations

import dataclasses
import functools
import itertools
from collections.abc import Callable, Sequence
from typing import Any

import cv2
import numpy as np

from tracker.calibration.board.board import Board
from tracker.conventions import Array, FloatArray, Image
from tracker.errors import CalibrationError
from tracker.geometry import so3

FEWEST_CORNERS = 4
"""Smallest number of corners that determines the board's pose."""

MOST_BLUR = 1.5
"""Largest standard deviation [px] of the blur; above it, markers are missed and corners shift."""

MANY_TIMES = 3.0
"""A photo is an outlier if its residual exceeds that of the others by this factor."""

_WRONG_CORNER = 6.0
"""A corner is an outlier if its residual exceeds this many standard deviations."""

Optics = tuple[FloatArray, FloatArray]
"""Matrix (3, 3) [px] and distortion of a lens."""

_ACROSS, _ALONG = 0.11, 0.06
"""Half extent of an edge's profile, across and along it [edge lengths]; it ends before the marker begins."""


@dataclasses.dataclass(frozen=True, eq=False)
class BoardView:
    """A board as seen in a photo."""

    photo: str
    size: tuple[int, int]
    """Width and height of the photo [px]."""
    corners: Array
    """Numbers (N,) of the corners found, ascending."""
    pixels: FloatArray
    """Positions (N, 2) of the corners in the photo [px]."""
    points: FloatArray
    """Positions (N, 3) of the corners in the board's frame [m]."""
    blur: float
    """Median standard deviation of the blur across the squares' edges [px]; NaN if no edge is seen."""

    def __len__(self) -> int:
        return len(self.corners)

    @property
    def fixes_pose(self) -> bool:
        """Whether the corners determine the board's pose: of four or more, two lie off any line."""
        # At most one of the first three is off a line that holds all, or all but one.
        lines = itertools.combinations(self.points[:3], 2)
        off = [np.abs(np.cross(end - start, self.points - start)[:, 2]) > 1e-9 for start, end in lines]
        return len(self) >= FEWEST_CORNERS and all(np.count_nonzero(one) > 1 for one in off)

    def without(self, dropped: Array) -> BoardView:
        """Return the view without the corners that a mask (N,) selects."""
        kept = ~np.asarray(dropped, bool)
        return dataclasses.replace(
            self, corners=self.corners[kept], pixels=self.pixels[kept], points=self.points[kept]
        )

    def pose(self, optics: Optics) -> FloatArray:
        """Return camera_from_board (4, 4) [m] with the smallest reprojection error."""
        return self.poses(optics)[0]

    def poses(self, optics: Optics) -> list[FloatArray]:
        """Return both poses (4, 4) [m] with locally smallest errors, the better one first.

        A distant plane looks the same in two poses (Collins and Bartoli, Infinitesimal plane-based pose
        estimation, 2014).
        """
        seen = self.points, self.pixels, *optics
        count, turns, shifts, _ = cv2.solvePnPGeneric(*seen, flags=cv2.SOLVEPNP_IPPE)
        starts = zip(turns[:count], shifts[:count], strict=True)
        poses = [
            self.refined(so3.transform(so3.exp(turn.ravel()), shift.ravel()), optics)
            for turn, shift in starts
        ]
        return sorted(poses, key=lambda pose: rms([self.misses(pose, optics)]))

    def refined(self, pose: FloatArray, optics: Optics) -> FloatArray:
        """Return the pose (4, 4) [m] near the given one with the locally smallest reprojection error."""
        turn, shift = cv2.Rodrigues(pose[:3, :3])[0], pose[:3, 3:].copy()
        better = cv2.solvePnPRefineLM(self.points, self.pixels, *optics, turn, shift)
        found = np.concatenate(better).astype(np.float64).ravel()
        return so3.transform(so3.exp(found[:3]), found[3:])

    def misses(self, camera_from_board: FloatArray, optics: Optics) -> FloatArray:
        """Return the residuals (N, 2) at a pose (4, 4): observed minus projected corners [px]."""
        turn = cv2.Rodrigues(camera_from_board[:3, :3])[0]
        put, _ = cv2.projectPoints(self.points, turn, camera_from_board[:3, 3], *optics)
        return self.pixels - np.asarray(put).reshape(-1, 2)

    def least_misses(self, optics: Optics) -> FloatArray:
        """Return the residuals (N, 2) at the pose that fits best [px]."""
        return self.misses(self.pose(optics), optics)


def rms(residuals: Sequence[FloatArray]) -> float:
    """Return the root mean square length [px] of residuals (N, 2); NaN if there are none."""
    together = np.concatenate([np.empty((0, 2)), *residuals])
    return float(np.sqrt((together**2).sum(axis=1).mean())) if len(together) else float("nan")


def without_wrong(
    views: Sequence[BoardView],
    misses: Callable[[Sequence[BoardView]], Sequence[FloatArray]],
    least: Sequence[float],
) -> list[BoardView]:
    """Return the views without outlying corners; one that would keep too few corners is left as it is.

    Too few are fewer than its `least`, and those that do not fix the board's pose. `misses` returns the
    residuals (N, 2) of each view. The standard deviation is estimated from their median, which a few outliers
    hardly affect. If a photo's own is larger, it is used, so a photo that fits badly keeps its corners and is
    judged as a whole.
    """
    cleaned = list(views)
    for _ in range(3):  # a gross outlier can mask others
        before, cleaned, residuals = cleaned, [], misses(cleaned)
        spread = _spread(np.concatenate(residuals))
        for view, missed, count in zip(before, residuals, least, strict=True):
            own = max(spread, _spread(missed) if len(missed) else 0.0)
            fewer = view.without(np.linalg.norm(missed, axis=1) > _WRONG_CORNER * own)
            cleaned.append(fewer if fewer.fixes_pose and len(fewer) >= count else view)
        if list(map(len, cleaned)) == list(map(len, before)):
            break
    return cleaned


def _spread(residuals: FloatArray) -> float:
    """Return the deviation per axis [px] whose Rayleigh distribution has the observed median length."""
    return float(np.median(np.linalg.norm(residuals, axis=1))) / float(np.sqrt(2 * np.log(2)))


CLEAR = 0.7
"""Half width of the window in which a corner is refined, relative to its distance from the markers."""


def find_board(photo: str, image: Image, board: Board) -> BoardView | None:
    """Detect the board in an image (H, W, 3) or (H, W); None if the corners found do not fix its pose."""
    gray = grey(image)
    pixels, numbers, _, _ = _detector(board).detectBoard(gray)
    if numbers is None or len(numbers) < FEWEST_CORNERS:
        return None
    order = np.argsort(numbers.ravel())
    found = numbers.ravel()[order]
    places = np.asarray(pixels, np.float64).reshape(-1, 2)[order]
    beside = _neighbours(found.tolist(), board.columns - 1)
    places = _refined(gray, places, beside, board)
    # A moving board is blurred differently along rows and columns: the larger blur counts.
    blurs = [[_profile_blur(gray, *places[pair]) for pair in pairs] for pairs in beside]
    blur = max((float(np.median(some)) for some in blurs if some), default=float("nan"))
    view = BoardView(photo, (gray.shape[1], gray.shape[0]), found, places, board.corners[found], blur)
    return view if view.fixes_pose else None


def _neighbours(numbers: list[int], columns: int) -> tuple[Array, Array]:
    """Return pairs (N, 2) of adjacent corners, as indices into `numbers`: those along rows, then columns."""
    at = {number: k for k, number in enumerate(numbers)}
    right = [(k, at[n + 1]) for n, k in at.items() if n + 1 in at and (n + 1) % columns]
    below = [(k, at[n + columns]) for n, k in at.items() if n + columns in at]
    return np.array(right, int).reshape(-1, 2), np.array(below, int).reshape(-1, 2)


def _refined(gray: Image, places: FloatArray, beside: Sequence[Array], board: Board) -> FloatArray:
    """Return corners (N, 2) refined to saddle points, since those of OpenCV 4 are off by half a pixel.

    The windows end well before the markers, whose blurred edges would pull the corners towards them. The
    nearest marker's corner lies along the shorter diagonal of a square.
    """
    steps = [places[pairs[:, 1]] - places[pairs[:, 0]] for pairs in beside]
    right, down = (step.sum(axis=0) / max(len(step), 1) for step in steps)
    edge = np.sqrt(0.5) * min(np.hypot(*(right + down)), np.hypot(*(right - down)))
    half = max(2, round(CLEAR * 0.5 * (1.0 - board.marker / board.square) * edge))
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 50, 1e-3)
    points = places.astype(np.float32).reshape(-1, 1, 2)
    refined: Any = cv2.cornerSubPix(gray, points, (half, half), (-1, -1), stop)
    return np.asarray(refined, np.float64).reshape(-1, 2)


def grey(image: Image) -> Image:
    """Return the brightness (H, W) of an image (H, W, 3) BGR or (H, W)."""
    return image if image.ndim == 2 else np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)


def pattern_seen(images: Sequence[Image], board: Board) -> Board:
    """Return the board with the pattern, old or current, that yields more corners in the images."""
    if not board.two_patterns:
        return board
    both = board, dataclasses.replace(board, legacy=not board.legacy)
    return max(both, key=lambda one: sum(len(find_board("", image, one) or ()) for image in images))


def squares_shown(sightings: Sequence[BoardView], board: Board) -> tuple[int, int]:
    """Return the columns and rows of squares that the corners of all views together span."""
    rows, columns = np.divmod(np.concatenate([one.corners for one in sightings]), board.columns - 1)
    return int(np.ptp(columns)) + 2, int(np.ptp(rows)) + 2


def why_no_board(image: Image, board: Board) -> str:
    """Say briefly what is wrong with an image (H, W, 3) or (H, W) in which `find_board` finds nothing."""
    gray = grey(image)
    if find_board("", np.ascontiguousarray(gray[:, ::-1]), board) is not None:
        return "the photo is mirrored"
    blur = photo_blur(gray)
    if blur > MOST_BLUR:
        return f"the photo is blurred, its sharpest edges by {blur:.1f} px"
    numbers = _detector(board).detectBoard(gray)[1]
    if numbers is not None and len(numbers) >= FEWEST_CORNERS:
        return f"of its {len(numbers)} corners all, or all but one, lie in a line, which leaves the pose open"
    count = len(_markers(gray, board))
    if count >= 4:
        squares = f"{board.columns}x{board.rows} squares"
        return f"its {count} markers do not lie as on a board of {squares}, or it is seen too obliquely"
    if count:
        return f"only {count} markers of {board.dictionary} found, no {FEWEST_CORNERS} corners between them"
    return f"no marker of {board.dictionary} found"


def require_size(photo: str, image: Image, board: Board) -> None:
    """Raise CalibrationError if an image shows markers that the stated board does not have."""
    edges = _markers(grey(image), board)
    known = set(board.opencv.getIds().ravel().tolist())
    usual = np.median([edge for number, edge in edges.items() if number in known] or [0.0])
    # Specks can also be detected as markers, but they are smaller.
    more = [number for number, edge in edges.items() if number not in known and edge > 0.5 * usual]
    if len(more) > 1:
        raise CalibrationError(
            f"{photo}: found the markers {', '.join(map(str, sorted(more)))}, which are not on a "
            f"board of {board.columns}x{board.rows} squares; expected the size of the whole board"
        )


def _markers(gray: Image, board: Board) -> dict[int, float]:
    """Return the numbers of all markers in an image, with the length of their edges [px]."""
    found: Any = cv2.aruco.ArucoDetector(board.markers).detectMarkers(gray)
    corners, numbers = found[:2]
    edges = [cv2.arcLength(one, True) / 4.0 for one in corners]
    return {} if numbers is None else dict(zip(numbers.ravel().tolist(), edges, strict=True))


def photo_blur(gray: Image) -> float:
    """Return the blur [px] of the strongest edges of any image (H, W); NaN if it has none.

    Blurring the image by a further s reduces the slope of an edge of blur σ by the factor σ/√(σ² + s²)
    (Zhuo and Sim, Defocus map estimation from a single image, 2011). Motion blurs rows and columns
    differently; the larger blur is returned.
    """
    image = gray.astype(np.float32)
    return float(np.fmax(_blur_along_rows(image), _blur_along_rows(np.ascontiguousarray(image.T))))


def _blur_along_rows(image: Array) -> float:
    if min(image.shape) < 2:
        return float("nan")
    more = 2.0
    beside, slope = np.abs(np.gradient(image))
    strong = slope >= max(float(np.quantile(slope, 0.995)), 1.0)
    if not strong.any():
        return float("nan")
    again = cv2.GaussianBlur(image, (0, 1), more, sigmaY=1e-6)
    slope_again = np.abs(np.gradient(again, axis=1))
    ratio = slope[strong] / np.maximum(slope_again[strong], 1e-6)
    across = slope[strong] / np.hypot(beside, slope)[strong]  # a slanting edge is wider along the row
    return float(np.median(more * across / np.sqrt(np.maximum(ratio**2 - 1, 1e-6))))


def _profile_blur(gray: Image, start: FloatArray, end: FloatArray) -> float:
    """Return the blur [px] of the edge between two corners, from the profile across its middle.

    A step blurred by a Gaussian of standard deviation σ has a maximum slope of step/(√(2π) σ).
    """
    along = end - start
    length = float(np.hypot(*along))
    across = np.array([-along[1], along[0]]) / length
    steps = np.linspace(-_ACROSS * length, _ACROSS * length, 41)
    values = np.zeros(len(steps))
    for offset in (-_ALONG, 0.0, _ALONG):
        where = ((start + end) / 2 + offset * along + steps[:, None] * across).astype(np.float32)
        values += cv2.remap(gray, where[:, :1], where[:, 1:], cv2.INTER_LINEAR).ravel() / 3
    slope = np.abs(np.gradient(values, steps)).max()
    return float(np.ptp(values) / (np.sqrt(2 * np.pi) * max(slope, 1e-9)))


@functools.lru_cache(maxsize=8)
def _detector(board: Board) -> Any:
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    return cv2.aruco.CharucoDetector(board.opencv, cv2.aruco.CharucoParameters(), parameters)
