"""Focal lengths, principal point and distortion of a camera, from photos of a board.

The fit is OpenCV's (Zhang, A flexible new technique for camera calibration, 2000). This module decides
which photos it uses and whether to trust it. Each photo is judged by a lens fitted without it, since a lens
fitted to all photos adapts to an outlier among them.
"""

import dataclasses
from collections.abc import Sequence

import cv2
import numpy as np

from tracker.calibration.board.board import Board
from tracker.calibration.board.sighting import (
    MANY_TIMES,
    BoardView,
    Optics,
    rms,
    squares_shown,
    without_wrong,
)
from tracker.calibration.files import Calibrated
from tracker.conventions import FloatArray
from tracker.errors import CalibrationError
from tracker.geometry.camera import Camera

FEWEST_PHOTOS, FEWEST_CORNERS = 6, 8
"""Smallest number of photos needed to fit a lens, and of corners in a photo that is used."""

MOST_FOCAL_STD = 0.01
"""Largest relative standard deviation of the focal lengths; it is exceeded if photos are too similar."""

LEAST_TILT = 15.0
"""Smallest angle between the two most different tilts of the board [degrees]; below it, a fit may give any
focal length, sometimes with small standard deviations."""

MOST_LEFT_OUT = 2e-3
"""Largest RMS of left-out photos [focal lengths], 1.2 px at 590; if larger, no single lens fits them all."""

_MORE_TILT = "tilt the board by 30° to 45° in all directions"

_PARTS = 6
"""Number of folds of the cross-validation: each part of the photos is left out once."""


@dataclasses.dataclass(frozen=True, eq=False)
class PhotoFit:
    """How well the lens fits a photo, and whether the photo was used."""

    sighting: BoardView
    """The view of the board, without outlying corners."""
    residuals: FloatArray
    """Residuals (N, 2) [px]: observed minus projected corners."""
    left_out: float
    """RMS residual [px] under a lens fitted without this photo."""
    dropped: int
    """Number of corners dropped as outliers."""
    fault: str | None = None
    """Why the photo was excluded from the fit; None if it was used."""


@dataclasses.dataclass(frozen=True, eq=False)
class Lens:
    """A camera's lens, estimated from photos of a board."""

    calibrated: Calibrated
    photos: tuple[PhotoFit, ...]
    """All photos, in the order given."""
    rms: float
    """RMS residual of the photos used [px]."""
    left_out: float
    """RMS residual of the same photos, each under a lens fitted without it [px]."""
    reach: float
    """Largest distance of a corner from the image centre [half diagonals]; beyond, the fit extrapolates."""


def fit_lens(name: str, sightings: Sequence[BoardView], board: Board) -> Lens:
    """Fit a camera's lens to views of a board, one per photo, and report the photos that do not fit.

    Raises:
        CalibrationError: the photos differ in size, are too few or too similar, never show whole rows of
            the board, or no lens fits them.
    """
    sizes = {one.size: one.photo for one in sightings}
    if len(sizes) > 1:
        found = ", ".join(f"{photo} of {size[0]}x{size[1]} px" for size, photo in sizes.items())
        raise CalibrationError(f"{name}: found {found}; expected photos of one size")
    size = next(iter(sizes), (0, 0))
    few = f"corners, expected {FEWEST_CORNERS}"
    faults = {n: f"only {len(one)} {few}" for n, one in enumerate(sightings) if len(one) < FEWEST_CORNERS}
    enough = [n for n in range(len(sightings)) if n not in faults]
    _require_photos(name, len(enough), len(sightings))
    shown = squares_shown([sightings[n] for n in enough], board)
    if shown != (board.columns, board.rows):  # the board is smaller than stated
        raise CalibrationError(
            f"{name}: all {len(enough)} photos show no more than {shown[0]}x{shown[1]} squares of the board, "
            f"expected {board.columns}x{board.rows}; is that its size?"
        )
    cleaned = list(sightings)

    def misses(views: Sequence[BoardView]) -> list[FloatArray]:
        optics, _ = _fit(views, size)
        return [one.least_misses(optics) for one in views]

    # Remove corners that were detected in the wrong place.
    views = [sightings[n] for n in enough]
    for n, one in zip(enough, without_wrong(views, misses, [FEWEST_CORNERS] * len(views)), strict=True):
        cleaned[n] = one
    left_out, strange = _judged(name, cleaned, enough, size)
    faults |= strange
    kept = [number for number in enough if number not in faults]
    optics, std = _fit([cleaned[n] for n in kept], size)
    residuals = [one.least_misses(optics) for one in cleaned]
    both = rms([residuals[n] for n in kept]), float(np.sqrt(np.mean(left_out[kept] ** 2)))
    normals = np.array([cleaned[n].pose(optics)[:3, 2] for n in kept])
    _require_belief(name, optics[0][(0, 1), (0, 1)], std, normals, *both)
    center = (np.array(size) - 1) / 2
    farthest = max(np.linalg.norm(cleaned[n].pixels - center, axis=1).max() for n in kept)
    return Lens(
        Calibrated(
            Camera(name, *size, *optics, np.eye(4)),
            np.array([[std[0], 0, std[2]], [0, std[1], std[3]], [0, 0, 0]]),
            std[4:],
            placed=False,
        ),
        tuple(
            PhotoFit(one, residuals[n], left_out[n], len(sightings[n]) - len(one), faults.get(n))
            for n, one in enumerate(cleaned)
        ),
        *both,
        float(farthest / np.linalg.norm(center)),
    )


def _judged(
    name: str, sightings: Sequence[BoardView], numbers: Sequence[int], size: tuple[int, int]
) -> tuple[FloatArray, dict[int, str]]:
    """Return each photo's left-out RMS (N,) [px], NaN if not in `numbers`, and faults by photo number."""
    left_out = np.full(len(sightings), np.nan)
    faults: dict[int, str] = {}
    kept = list(numbers)
    while True:
        left_out[kept] = _left_out([sightings[n] for n in kept], size)
        usual = float(np.median(left_out[kept]))
        worst = max(kept, key=lambda n: left_out[n])
        if left_out[worst] <= MANY_TIMES * usual:
            return left_out, faults
        kept.remove(worst)
        faults[worst] = f"misses by {left_out[worst]:.2f} px, the others by {usual:.2f}"
        _require_photos(name, len(kept), len(sightings))


def _fit(sightings: Sequence[BoardView], size: tuple[int, int]) -> tuple[Optics, FloatArray]:
    """Fit a lens with five coefficients; return it and the deviations (9,) of fx, fy, cx, cy, k1, …, k3."""
    points = [one.points.astype(np.float32) for one in sightings]
    pixels = [one.pixels.astype(np.float32) for one in sightings]
    fitted = cv2.calibrateCameraExtended(points, pixels, size, np.eye(3), np.zeros(5))
    matrix, distortion, std = (np.asarray(fitted[place], np.float64) for place in (1, 2, 5))
    return (matrix, distortion.ravel()[:5]), std.ravel()[:9]


def _left_out(sightings: Sequence[BoardView], size: tuple[int, int]) -> list[float]:
    """Return the RMS residual [px] of each photo under a lens fitted without its part of the photos."""
    parts = min(_PARTS, len(sightings))
    result = [0.0] * len(sightings)
    for part in range(parts):
        optics, _ = _fit([one for n, one in enumerate(sightings) if n % parts != part], size)
        for number in range(part, len(sightings), parts):
            result[number] = rms([sightings[number].least_misses(optics)])
    return result


def _require_photos(name: str, found: int, all_photos: int) -> None:
    if found < FEWEST_PHOTOS:
        raise CalibrationError(
            f"{name}: found {found} usable photos, of {all_photos} with a board; expected at least "
            f"{FEWEST_PHOTOS}, better 15, with the board tilted in all directions and out to the corners"
        )


def _require_belief(
    name: str, focal: FloatArray, std: FloatArray, normals: FloatArray, missed: float, left_out: float
) -> None:
    """Raise if the photos are too similar, by the boards' normals (N, 3), or the lens fits them badly."""
    limit = MOST_LEFT_OUT * float(focal.min())
    spread = float(np.rad2deg(np.arccos(np.clip((normals @ normals.T).min(), -1, 1))))
    if spread < LEAST_TILT:
        raise CalibrationError(
            f"{name}: the board is tilted by no more than {spread:.0f}° from photo to photo, expected "
            f"at least {LEAST_TILT:.0f}°: the photos are too alike; {_MORE_TILT}"
        )
    if not left_out <= limit:
        raise CalibrationError(
            f"{name}: photos left out miss by {left_out:.2f} px RMS, expected at most "
            f"{limit:.2f}: the board is not flat, or the photos are not of one camera and focus"
        )
    if not missed <= MANY_TIMES * left_out:  # the fit to all of them diverged
        raise CalibrationError(
            f"{name}: photos miss by {missed:.2f} px RMS, photos left out by {left_out:.2f}: "
            f"the photos are too alike; {_MORE_TILT}"
        )
    if not (std[:2] <= MOST_FOCAL_STD * focal).all():
        raise CalibrationError(
            f"{name}: the focal length is {focal[0]:.0f} ± {std[:2].max():.0f} px, expected it to "
            f"{100 * MOST_FOCAL_STD:.0f} %: the photos are too alike; {_MORE_TILT}"
        )
