"""Does a calibration fit? Judged by where each camera by itself sees an object that all see.

A camera c whose transform is off by ξ_c = (a, w), see `deviations`, sees an object at P moved by
d_c = -G(P) ξ_c, with G(P) = [I, -[P]×; 0, I]. Over many looks at still objects, each with a pose of its own,
the ξ_c follow by least squares with the poses eliminated; what all cameras have in common stays as it is.
What the files state of errors is the prior, and a camera is said to have moved if the looks are much more
probable with its ξ_c left free.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tracker.calibration.deviations import calibration_covariance
from tracker.conventions import Array, FloatArray
from tracker.errors import CalibrationError
from tracker.geometry import so3
from tracker.geometry.camera import Camera

LEAST = 1
"""Looks that a judgement takes."""

OFTEN = 3
"""Looks that it takes to name a camera: in one alone, what hides a camera's view looks like a motion."""

LIMIT = 1.6 / 295
"""Angle [rad] by which cameras may miss what the others see, in the median over looks: 1.6 px on the
platform, 3 mm at half a metre."""

TYPICAL = 5e-4, 1.75e-3
"""Standard deviations of cameras whose files state none [m, rad]."""

LOOSE = 0.03, 0.09
"""The same of a camera that may have moved."""

ACROSS, ALONG, TILT, ROLL = 3e-4, 4e-3, 8e-3, 3e-3
"""Errors of one camera's view that are not its calibration's, over its distance: across the line of sight and
along it; and about axes across it and along it [rad]."""

SAME = 20.0
"""Looks after which errors of a camera's view no longer average away."""

MOVED = 6.0
"""Gain in log likelihood from which a camera is said to have moved: cameras that are off as their files state
stay below it in 95 of 100 sets of forty looks, and of sixty in which one was off by 3 mm 58 are above it."""

FREEDOM = 4.0
"""Degrees of freedom of Student's t, by which a look counts the less the farther off it is."""

LOST = 0.6
"""Share of the looks in which a camera should see the object and cannot use it, from which on it is named."""

ROUNDS = 6


class Look(NamedTuple):
    """Where each camera by itself sees a still object."""

    position: FloatArray
    """(3,) of the object, as all cameras together have it [m]."""
    information: FloatArray
    """(C, 6, 6) on the pose that each camera sees [1/m², 1/rad²]; zero where it sees too little."""
    moved: FloatArray
    """(C, 6) that pose less the joint one [m, rad]."""
    lost: Array
    """(C,) bool: whether the camera should see the object, shows its colours, and cannot use them."""


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
    """(4, 4) given_from_true: what reconciles it with the others, camera_from_world = correction · given."""
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
    problem = _Problem(looks, cameras)
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
    return _Problem(looks, cameras).misses() if looks else np.zeros((0, len(cameras), 2))


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


class _Problem:
    """The looks as least squares for the cameras' errors, the poses eliminated."""

    def __init__(self, looks: Sequence[Look], cameras: Sequence[Camera]) -> None:
        self.cameras, count = cameras, len(cameras)
        self.moved_by = np.array([look.moved for look in looks])
        self.lever = np.array([_lever(look.position) for look in looks])
        self.known = np.zeros((len(looks), count, 6, 6))
        self.distance = np.empty((len(looks), count))
        for f, look in enumerate(looks):
            for c, camera in enumerate(cameras):
                self.distance[f, c] = np.linalg.norm(camera.position - look.position)
                if look.information[c, 0, 0] > 0.0:
                    noise = _view_errors(camera, self.distance[f, c])
                    known = look.information[c]
                    self.known[f, c] = known - known @ np.linalg.solve(known + np.linalg.inv(noise), known)
        stated = np.array([_stated(camera) for camera in cameras])
        self.held = np.linalg.inv(stated)
        self.loose = np.diag(1.0 / np.repeat(np.square(LOOSE), 3))

    def solve(self, free: Sequence[int]) -> tuple[FloatArray, float]:
        """Errors (C, 6) of the cameras, and minus the log likelihood, with some cameras free to move."""
        count = len(self.cameras)
        prior = [self.loose if c in free else self.held[c] for c in range(count)]
        weights = np.full(self.known.shape[:2], 1.0)
        errors, cost = np.asarray(np.zeros((count, 6))), 0.0
        for _ in range(ROUNDS):
            matrix, vector = self._equations(weights)
            for c in range(count):
                matrix[6 * c : 6 * c + 6, 6 * c : 6 * c + 6] += prior[c]
            errors = np.asarray(np.linalg.solve(matrix, vector)).reshape(count, 6)
            squares = self._squares(errors, weights)
            share = min(1.0, SAME / len(self.known))
            cost = 0.5 * share * float(((FREEDOM + 6) * np.log1p(squares / FREEDOM)).sum())
            cost += 0.5 * sum(float(e @ p @ e) for e, p in zip(errors, prior, strict=True))
            weights = (FREEDOM + 6) / (FREEDOM + squares)
        return errors, cost

    def moved(self) -> list[int]:
        """Cameras that must have moved, the one that explains most first; all but one at most."""
        free: list[int] = []
        if len(self.known) < OFTEN:
            return free
        cost = self.solve(free)[1]
        while len(free) < len(self.cameras) - 1:
            left = [c for c in range(len(self.cameras)) if c not in free]
            costs = [self.solve([*free, c])[1] for c in left]
            best = int(np.argmin(costs))
            if cost - costs[best] < MOVED:
                break
            free.append(left[best])
            cost = costs[best]
        return free

    def misses(self) -> FloatArray:
        """(looks, C, 2) by which each camera misses the pose of the others [px]; NaN: not known."""
        result = np.full((*self.known.shape[:2], 2), np.nan)
        for f, known in enumerate(self.known):
            for c, camera in enumerate(self.cameras):
                others = [k for k in range(len(known)) if k != c and known[k, 0, 0] > 0.0]
                if not others or known[c, 0, 0] <= 0.0:
                    continue
                # A pose that the others leave open is taken from the camera itself.
                joint = known[others].sum(axis=0) + 1e-3 * known[c]
                pull = np.einsum("kij,kj->i", known[others], self.moved_by[f, others])
                pull += 1e-3 * known[c] @ self.moved_by[f, c]
                off = self.moved_by[f, c] - np.linalg.solve(joint, pull)
                across = (camera.camera_from_world[:3, :3] @ off[:3])[:2] / self.distance[f, c]
                result[f, c] = across * [camera.matrix[0, 0], camera.matrix[1, 1]]
        return result

    def _poses(self, known: FloatArray, seen: FloatArray) -> FloatArray:
        """(looks, 6) of the object where the cameras' views are (looks, C, 6)."""
        joint = known.sum(axis=1) + np.diag(np.repeat([1.0, 1e-2], 3))
        pull = np.einsum("fcij,fcj->fi", known, seen)
        return np.asarray(np.linalg.solve(joint, pull[..., None])[..., 0])

    def _equations(self, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Normal equations (6 C, 6 C), (6 C,) of the errors without prior."""
        share = min(1.0, SAME / len(self.known))
        known = share * weights[..., None, None] * self.known
        count = len(self.cameras)
        joint = known.sum(axis=1) + np.diag(np.repeat([1.0, 1e-2], 3))
        pulled = np.einsum("fji,fcjk->fcik", self.lever, known)  # Gᵀ A
        reduced = np.linalg.solve(joint[:, None], known)  # S⁻¹ A
        matrix = np.zeros((count, 6, count, 6))
        for c in range(count):
            for k in range(count):
                part = -pulled[:, c] @ reduced[:, k] @ self.lever
                if c == k:
                    part = part + pulled[:, c] @ self.lever
                matrix[c, :, k, :] = part.sum(axis=0)
        off = self.moved_by - self._poses(known, self.moved_by)[:, None]
        vector = -np.einsum("fcij,fcj->ci", pulled, off)
        return matrix.reshape(6 * count, 6 * count), vector.reshape(-1)

    def _squares(self, errors: FloatArray, weights: FloatArray) -> FloatArray:
        """(looks, C) squared residuals in their standard deviations."""
        seen = self.moved_by + np.einsum("fij,cj->fci", self.lever, errors)
        off = seen - self._poses(weights[..., None, None] * self.known, seen)[:, None]
        return np.asarray(np.einsum("fci,fcij,fcj->fc", off, self.known, off))


def _lever(position: FloatArray) -> FloatArray:
    """(6, 6) G of the module's docstring at a position (3,)."""
    lever = np.eye(6)
    lever[:3, 3:] = -so3.hat(position)
    return lever


def _view_errors(camera: Camera, distance: float) -> FloatArray:
    """(6, 6) covariance of what one view cannot know, along world axes."""
    turn = np.kron(np.eye(2), camera.camera_from_world[:3, :3].T)
    std = [ACROSS * distance, ACROSS * distance, ALONG * distance, TILT, TILT, ROLL]
    return np.asarray(turn @ np.diag(np.square(std)) @ turn.T)


def _stated(camera: Camera) -> FloatArray:
    """(6, 6) covariance of the error (a, w) that a file states, or of typical ones."""
    std = camera.camera_from_world_std
    if std is None or not np.any(std):
        return np.diag(np.repeat(np.square(TYPICAL), 3))
    return calibration_covariance(camera)
