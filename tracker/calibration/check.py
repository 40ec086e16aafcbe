"""Does a calibration fit? Judged by where each camera by itself sees an object that all see; see `looks`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tracker.calibration.looks import OFTEN, CameraErrors, Look
from tracker.conventions import FloatArray
from tracker.errors import CalibrationError
from tracker.geometry import so3
from tracker.geometry.camera import Camera

LEAST = 1
"""Looks that a judgement takes."""

LIMIT = 1.6 / 295
"""Angle [rad] by which cameras may miss what the others see, in the median over looks: 1.6 px on the
platform, 3 mm at half a metre."""

LOST = 0.6
"""Share of the looks in which a camera should see the object and cannot use it, from which on it is named."""


@dataclass(frozen=True, eq=False)
class CameraCheck:
    """What the looks say of one camera."""

    name: str
    looks: int
    """In which it sees the object."""
    lost: int
    """In which it should, and cannot use what it shows."""
    miss_px: float
    """Median miss of what the others see [px]; NaN where it was not asked."""
    moved: bool
    """Whether it is not where the calibration has it."""
    correction: FloatArray
    """(4, 4) what reconciles it with the others: camera_from_world is correction · given."""
    shift: float
    """Length of the correction of the camera's place [m], …"""
    turn: float
    """… and its angle [rad]."""


@dataclass(frozen=True, eq=False)
class CalibrationCheck:
    """Whether a calibration fits."""

    cameras: tuple[CameraCheck, ...]
    miss: float
    """Median over the looks of the cameras' root mean square miss [rad]."""
    looks: int
    misses: FloatArray
    """(looks, C, 2) by which each camera misses what the others see [px], right and down; NaN: not asked."""

    @property
    def fits(self) -> bool:
        """Whether the calibration fits the pictures."""
        return self.miss <= LIMIT and not any(one.moved or self.is_lost(one) for one in self.cameras)

    def is_lost(self, one: CameraCheck) -> bool:
        """Whether a camera cannot use what it shows, as a rule."""
        return one.lost >= max(OFTEN, LOST * self.looks)


def check_calibration(looks: Sequence[Look], cameras: Sequence[Camera]) -> CalibrationCheck:
    """Judge a calibration of two cameras or more by looks at still objects.

    Raises:
        CalibrationError: there are too few cameras or looks.
    """
    if len(cameras) < 2:
        raise CalibrationError(f"check: found {cameras[0].name} alone, expected two cameras or more")
    if len(looks) < LEAST:
        raise CalibrationError(
            "check: found no picture in which two cameras see the object still; expected one or more, better "
            "twenty"
        )
    problem = CameraErrors(looks, cameras)
    free = problem.moved()
    errors = problem.solve(free)[0]
    misses = problem.misses()
    result = []
    for c, camera in enumerate(cameras):
        lengths = np.linalg.norm(misses[:, c], axis=1)
        correction, shift, turn = _correction(camera, errors[c])
        result.append(
            CameraCheck(
                camera.name,
                int(np.count_nonzero(np.isfinite(lengths))),
                int(sum(bool(look.lost[c]) for look in looks)),
                float(np.nanmedian(lengths)) if np.isfinite(lengths).any() else float("nan"),
                c in free,
                correction,
                shift,
                turn,
            )
        )
    return CalibrationCheck(tuple(result), _median_miss(misses, cameras), len(looks), misses)


def misses_of(looks: Sequence[Look], cameras: Sequence[Camera]) -> FloatArray:
    """(looks, C, 2) by which each camera misses what the others see [px], right and down; NaN: not known."""
    return CameraErrors(looks, cameras).misses() if looks else np.zeros((0, len(cameras), 2))


def _median_miss(misses: FloatArray, cameras: Sequence[Camera]) -> float:
    """Median over the looks of the root mean square over the cameras [rad]."""
    focal = np.array([np.sqrt(camera.matrix[0, 0] * camera.matrix[1, 1]) for camera in cameras])
    squares = ((misses / focal[:, None]) ** 2).sum(axis=2)
    asked = np.isfinite(squares).sum(axis=1) > 1
    return float(np.median(np.sqrt(np.nanmean(squares[asked], axis=1)))) if asked.any() else 0.0


def _correction(camera: Camera, error: FloatArray) -> tuple[FloatArray, float, float]:
    """What undoes an error (a, w) of camera_from_world; how far it moves [m] and turns [rad] the camera."""
    rotation = camera.camera_from_world[:3, :3]
    back = np.eye(4)
    back[:3, :3] = so3.exp(-rotation @ error[3:])
    back[:3, 3] = camera.camera_from_world[:3, 3] - rotation @ error[:3]
    back[:3, 3] -= back[:3, :3] @ camera.camera_from_world[:3, 3]
    true = back @ camera.camera_from_world
    place = -true[:3, :3].T @ true[:3, 3]
    return back, float(np.linalg.norm(place - camera.position)), float(np.linalg.norm(error[3:]))
