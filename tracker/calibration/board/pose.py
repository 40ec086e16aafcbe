"""Where a board is before a camera, and what its corners miss."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from tracker.calibration.board.sighting import BoardView
from tracker.conventions import Array, FloatArray

MANY_TIMES = 3.0
"""A photo that misses by so many times what others miss is not of the same kind."""

_WRONG_CORNER = 6.0
"""A corner that misses by so many standard deviations was not found where it is."""


def board_pose(sighting: BoardView, matrix: FloatArray, distortion: FloatArray) -> FloatArray:
    """(4, 4) camera_from_board [m] that brings the corners nearest to where they are seen.

    Of the two poses in which a plane looks alike from afar (Collins and Bartoli, Infinitesimal plane-based
    pose estimation, 2014) the one that fits better, each refined.
    """
    seen = sighting.points, sighting.pixels, matrix, distortion
    count, turns, shifts, _ = cv2.solvePnPGeneric(*seen, flags=cv2.SOLVEPNP_IPPE)
    poses = []
    for turn, shift in zip(turns[:count], shifts[:count], strict=True):
        better = cv2.solvePnPRefineLM(*seen, np.array(turn), np.array(shift))
        found = np.concatenate(better).astype(np.float64).ravel()
        poses.append(transform(found[:3], found[3:]))
    return min(poses, key=lambda pose: rms([misses(sighting, pose, matrix, distortion)]))


def transform(turn: FloatArray, shift: FloatArray) -> FloatArray:
    """(4, 4) of a rotation vector [rad] and a translation [m]."""
    out = np.eye(4)
    out[:3, :3] = cv2.Rodrigues(turn)[0]
    out[:3, 3] = shift
    return out


def misses(
    sighting: BoardView, camera_from_board: FloatArray, matrix: FloatArray, distortion: FloatArray
) -> FloatArray:
    """(N, 2) where the corners are seen, less where a pose puts them [px]."""
    turn = cv2.Rodrigues(camera_from_board[:3, :3])[0]
    put, _ = cv2.projectPoints(sighting.points, turn, camera_from_board[:3, 3], matrix, distortion)
    result: FloatArray = sighting.pixels - np.asarray(put).reshape(-1, 2)
    return result


def least_misses(sighting: BoardView, matrix: FloatArray, distortion: FloatArray) -> FloatArray:
    """(N, 2) what the corners miss at the pose that fits them best [px]."""
    return misses(sighting, board_pose(sighting, matrix, distortion), matrix, distortion)


def rms(residuals: Sequence[FloatArray]) -> float:
    """Root mean square length [px] of residuals (N, 2); NaN of none."""
    together = [one for one in residuals if len(one)]
    if not together:
        return float("nan")
    return float(np.sqrt((np.concatenate(together) ** 2).sum(axis=1).mean()))


def wrong_corners(residuals: Sequence[FloatArray]) -> list[Array]:
    """Masks (N,) of corners that miss by far more than the others do, photo by photo.

    The spread is that of the median, which few wrong ones do not move; a photo's own where that is wider,
    so that one that misses as a whole keeps its corners, and is judged as a whole.
    """
    spread = _spread(np.concatenate(residuals))
    return [
        np.linalg.norm(one, axis=1) > _WRONG_CORNER * max(spread, _spread(one) if len(one) else 0.0)
        for one in residuals
    ]


def _spread(residuals: FloatArray) -> float:
    """Standard deviation along an axis [px] whose Rayleigh distribution has the median length seen."""
    return float(np.median(np.linalg.norm(residuals, axis=1))) / float(np.sqrt(2 * np.log(2)))
