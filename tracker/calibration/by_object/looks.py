"""By how much each camera is off, from where each by itself sees an object that all see.

A camera c whose transform is off by ξ_c = (a, w), see `deviations`, sees an object at P moved by
d_c = -G(P) ξ_c, with G(P) = [I, -[P]×; 0, I]. Over many looks at still objects, each with a pose of its own,
the ξ_c follow by least squares with the poses eliminated; what all cameras have in common stays as it is.
What the files state of errors is the prior, and a camera counts as moved if the looks are much more
probable with its ξ_c left free.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tracker.calibration.by_object.edges import seen_motion
from tracker.calibration.deviations import calibration_covariance, is_stated
from tracker.conventions import Array, FloatArray
from tracker.geometry.camera import Camera

OFTEN = 3
"""Looks that it takes to name a camera: in one alone, what hides a camera's view looks like a motion."""

TYPICAL = 5e-4, 1.75e-3
"""Standard deviations of cameras whose files state none [m, rad]."""

SHARES = (1.0, 0.3, 0.1, 0.03, 0.01)
"""Shares of the stated variance that errors may have: a calibration is often better than its file fears, and
where the other cameras agree so well, one that does not has moved."""

LOOSE = 0.03, 0.09
"""Standard deviations of a camera that may have moved [m, rad]."""

ACROSS, ALONG, TILT, ROLL = 3e-4, 4e-3, 8e-3, 3e-3
"""Errors of one camera's view that are not its calibration's, over its distance: across the line of sight and
along it; and about axes across it and along it [rad]."""

SAME = 20.0
"""Looks after which errors of a camera's view no longer average away."""

MOVED = 8.0
"""Gain in log likelihood from which a camera counts as moved."""

EVIDENT = -13.5
"""The same of the log evidence, for which it is enough that the others agree much better than stated. LOOSE
is far wider than most knocks, for which evidence pays: cameras that are off as stated have -14 and less, one
of exact ones that is off by 3 mm or 0.5° has -13 and more."""

FREEDOM = 4.0
"""Degrees of freedom of Student's t, by which a look counts the less the farther off it is."""

ROUNDS = 6
"""Solutions with robust weights."""


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
    corners: FloatArray
    """(N, 3) of the object, as all cameras together have them [m]."""


class CameraErrors:
    """The looks as least squares for the cameras' errors, the poses eliminated."""

    def __init__(self, looks: Sequence[Look], cameras: Sequence[Camera]) -> None:
        self.cameras, count = cameras, len(cameras)
        self.moved_by = np.array([look.moved for look in looks])
        self.lever = np.array([seen_motion(look.position) for look in looks])
        self.known = np.zeros((len(looks), count, 6, 6))
        self.distance = np.empty((len(looks), count))
        for f, look in enumerate(looks):
            for c, camera in enumerate(cameras):
                self.distance[f, c] = np.linalg.norm(camera.position - look.position)
                if look.information[c, 0, 0] > 0.0:
                    noise = _view_errors(camera, self.distance[f, c])
                    known = look.information[c]
                    self.known[f, c] = known - known @ np.linalg.solve(known + np.linalg.inv(noise), known)
        typical = np.diag(np.repeat(np.square(TYPICAL), 3))
        stated = [calibration_covariance(one) if is_stated(one) else typical for one in cameras]
        self.held = np.linalg.inv(np.array(stated))
        self.loose = np.diag(1.0 / np.repeat(np.square(LOOSE), 3))

    def solve(self, free: Sequence[int], share: float = 1.0) -> tuple[FloatArray, float, float]:
        """Errors (C, 6) of the cameras with some of them free to move; its cost, and minus the log evidence.

        share: of the variance that the files state.
        """
        count = len(self.cameras)
        prior = [self.loose if c in free else self.held[c] / share for c in range(count)]
        weights = np.full(self.known.shape[:2], 1.0)
        for _ in range(ROUNDS):
            matrix, vector = self._equations(weights)
            for c in range(count):
                matrix[6 * c : 6 * c + 6, 6 * c : 6 * c + 6] += prior[c]
            errors = np.asarray(np.linalg.solve(matrix, vector)).reshape(count, 6)
            seen = self.moved_by + np.einsum("fij,cj->fci", self.lever, errors)
            off = seen - self._poses(weights[..., None, None] * self.known, seen)[:, None]
            squares = np.einsum("fci,fcij,fcj->fc", off, self.known, off)  # in their standard deviations
            known = min(1.0, SAME / len(self.known))
            cost = 0.5 * known * float(((FREEDOM + 6) * np.log1p(squares / FREEDOM)).sum())
            cost += 0.5 * sum(float(e @ p @ e) for e, p in zip(errors, prior, strict=True))
            weights = (FREEDOM + 6) / (FREEDOM + squares)
        volume = np.linalg.slogdet(matrix)[1] - sum(np.linalg.slogdet(p)[1] for p in prior)
        return errors, cost, cost + 0.5 * float(volume)

    def evidence(self, free: Sequence[int]) -> float:
        """Log evidence for these cameras to have moved, whatever share of what is stated others are off."""
        found = np.array([-self.solve(free, share)[2] for share in SHARES])
        return float(found.max() + np.log(np.mean(np.exp(found - found.max()))))

    def moved(self) -> list[int]:
        """Cameras that must have moved, the one that explains most first; all but one at most."""
        free: list[int] = []
        if len(self.known) < OFTEN:
            return free
        cost, evidence = self.solve(free)[1], self.evidence(free)
        while len(free) < len(self.cameras) - 1:
            left = [c for c in range(len(self.cameras)) if c not in free]
            costs = [self.solve([*free, c])[1] for c in left]
            best = int(np.argmin(costs))
            after = self.evidence([*free, left[best]])
            if cost - costs[best] < MOVED and after - evidence < EVIDENT:
                break
            free.append(left[best])
            cost, evidence = costs[best], after
        return free

    def misses(self) -> FloatArray:
        """(looks, C, 2) by which each camera misses the pose of the others [px]; NaN: not known."""
        result = np.full((*self.known.shape[:2], 2), np.nan)
        for f in range(len(self.known)):
            for c, camera in enumerate(self.cameras):
                shares = self.shares(f, c)
                if shares is not None:
                    off = np.einsum("kij,kj->i", shares, self.moved_by[f])
                    across = (camera.camera_from_world[:3, :3] @ off[:3])[:2] / self.distance[f, c]
                    result[f, c] = across * [camera.matrix[0, 0], camera.matrix[1, 1]]
        return result

    def shares(self, f: int, c: int) -> FloatArray | None:
        """(C, 6, 6) by which each camera's view has a part in where c sees the object against the others.

        None where c or all others see too little in look f.
        """
        known = self.known[f].copy()
        if known[c, 0, 0] <= 0.0 or not (np.delete(known[:, 0, 0], c) > 0.0).any():
            return None
        known[c] *= 1e-3  # a pose that the others leave open is taken from the camera itself
        result: FloatArray = -np.linalg.solve(known.sum(axis=0), known)
        result[c] += np.eye(6)
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


def _view_errors(camera: Camera, distance: float) -> FloatArray:
    """(6, 6) covariance of what one view cannot know, along world axes."""
    turn = np.kron(np.eye(2), camera.camera_from_world[:3, :3].T)
    std = [ACROSS * distance, ACROSS * distance, ALONG * distance, TILT, TILT, ROLL]
    return np.asarray(turn @ np.diag(np.square(std)) @ turn.T)
