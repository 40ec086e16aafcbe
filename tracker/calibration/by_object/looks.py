"""Estimate the error of each camera from the poses in which the cameras separately see the same object.

A camera c whose true transform is off by -ξ_c = (a, w) (see `deviations`) sees an object at P displaced by
d_c = -G(P) ξ_c, with G(P) = [I, -[P]×; 0, I]. From many looks at still objects, each with an unknown pose,
least squares with the poses eliminated gives the ξ_c; an error common to all cameras is not observable.
The errors stated in the files are the prior. A camera counts as moved if the looks are much more probable
with its ξ_c free.
"""

import functools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tracker.calibration.by_object.edges import seen_motion
from tracker.calibration.by_object.sightings import APART
from tracker.calibration.deviations import calibration_covariance, is_stated
from tracker.conventions import Array, FloatArray
from tracker.geometry.camera import Camera
from tracker.pose.agreement import ACROSS, ALONG, ROLL, TILT

OFTEN = 3
"""Smallest number of places of looks to call a camera moved; in a single one, an occlusion may resemble a
motion."""

TYPICAL = 5e-4, 1.75e-3
"""Standard deviations assumed at the object for cameras whose files state none [m, rad]."""

SHARES = (1.0, 0.3, 0.1, 0.03, 0.01)
"""Candidate ratios of actual to stated variance: a calibration is often better than its file states. If the
other cameras agree that well, a camera that disagrees with them has moved."""

LOOSE = 0.03, 0.09
"""Prior standard deviations at the object of a camera that may have moved [m, rad]."""

SAME = 20.0
"""Number of places beyond which the errors of a camera's view no longer average out. In one place, no corner
of the object moves by more than APART."""

MOVED = 8.0
"""Gain in log likelihood from which a camera counts as moved."""

EVIDENT = 9.0
"""Sum of the gains in log likelihood and log evidence of SHARES from which a camera counts as moved, as the
others may agree much better than stated: cameras off as stated rarely gain as much, whatever is stated; with
0.5 mm and 0.1° stated, one off by 3 mm among exact ones gains 15 or more."""

_FAINT = np.diag(np.repeat([1.0, 1e-2], 3))
"""Information (6, 6) on every pose, so that there is some about each direction [1/m², 1/rad²]."""

FREEDOM, ROUNDS = 4.0, 6
"""Degrees of freedom of Student's t, which gives outlying looks less weight; iterations of reweighting."""


class Look(NamedTuple):
    """The poses in which the cameras separately see a still object."""

    position: FloatArray
    """Position (3,) of the object according to all cameras together [m]."""
    information: FloatArray
    """Information (C, 6, 6) on the pose that each camera sees [1/m², 1/rad²]; zero if it sees too little."""
    moved: FloatArray
    """The pose (C, 6) that each camera sees minus the joint pose [m, rad]."""
    lost: Array
    """(C,) bool: whether a camera should see the object and shows its colours, but they are unusable."""
    corners: FloatArray
    """Corners (N, 3) of the object according to all cameras together [m]."""


class CameraErrors:
    """Least squares for the cameras' errors over all looks, with the object's poses eliminated."""

    def __init__(self, looks: Sequence[Look], cameras: Sequence[Camera]) -> None:
        self.cameras, count = cameras, len(cameras)
        self.focal = np.array([camera.matrix[(0, 1), (0, 1)] for camera in cameras])
        self.moved_by = np.array([look.moved for look in looks])
        self.lever = np.array([seen_motion(look.position) for look in looks])
        self.known = np.zeros((len(looks), count, 6, 6))
        self.distance = np.empty((len(looks), count))
        # Derivatives of the object's place in each image, divided by the focal lengths [1/m].
        self.across = np.empty((len(looks), count, 2, 3))
        for f, look in enumerate(looks):
            for c, camera in enumerate(cameras):
                self.distance[f, c] = np.linalg.norm(camera.position - look.position)
                slope = camera.project_with_jacobian(look.position[None])[1][0]
                self.across[f, c] = slope / self.focal[c, :, None]
                if look.information[c, 0, 0] > 0.0:
                    # The errors inherent in one view: across the line of sight, and along it.
                    away, sight = self.distance[f, c], look.position - camera.position
                    along = np.outer(sight, sight) / away**2
                    noise = np.kron(np.diag(np.square([ACROSS * away, TILT])), np.eye(3) - along)
                    noise += np.kron(np.diag(np.square([ALONG * away, ROLL])), along)
                    known = look.information[c]
                    self.known[f, c] = known - known @ np.linalg.solve(known + np.linalg.inv(noise), known)
        seen = self.known[:, :, 0, 0] > 0.0
        self.compared = seen & (seen.sum(axis=1, keepdims=True) > 1)
        # Unstated errors are those at the object: the world's origin may be far away.
        middle = seen_motion(np.mean([look.position for look in looks], axis=0))
        typical, self.loose = (
            middle.T @ np.diag(np.repeat(np.square(std), 3) ** -1.0) @ middle for std in (TYPICAL, LOOSE)
        )
        self.held = np.array(
            [calibration_covariance(one, -1) if is_stated(one) else typical for one in cameras]
        )
        # Looks in one place count as one: the errors of a view are the same in all of them.
        ends = np.array([look.corners.ravel() for look in looks])
        alike = np.array([np.sum(np.abs(ends - one).max(axis=1) < APART[0]) for one in ends])
        self.places = 1.0 / alike
        self.share = (min(1.0, SAME / self.places.sum()) * self.places)[:, None]

    def solve(self, free: Sequence[int], share: float = 1.0) -> tuple[FloatArray, float, float]:
        """Return the cameras' errors (C, 6) if those in `free` may have moved, the cost, and -log evidence.

        share: ratio of the actual variance to the stated one.
        """
        count = len(self.cameras)
        prior = [self.loose if c in free else self.held[c] / share for c in range(count)]
        weights = np.full(self.known.shape[:2], 1.0)
        for _ in range(ROUNDS):
            matrix, vector = self._equations(weights)
            matrix.reshape(count, 6, count, 6)[np.arange(count), :, np.arange(count)] += prior
            errors = np.asarray(np.linalg.solve(matrix, vector)).reshape(count, 6)
            seen = self.moved_by + np.einsum("fij,cj->fci", self.lever, errors)
            off = seen - self._poses(weights[..., None, None] * self.known, seen)[:, None]
            squares = np.einsum("fci,fcij,fcj->fc", off, self.known, off)  # squared Mahalanobis distance
            cost = 0.5 * float((self.share * (FREEDOM + 6) * np.log1p(squares / FREEDOM)).sum())
            cost += 0.5 * sum(float(e @ p @ e) for e, p in zip(errors, prior, strict=True))
            weights = (FREEDOM + 6) / (FREEDOM + squares)
        volume = np.linalg.slogdet(matrix)[1] - sum(np.linalg.slogdet(p)[1] for p in prior)
        return errors, cost, cost + 0.5 * float(volume)

    def evidence(self, free: Sequence[int]) -> tuple[float, FloatArray]:
        """Return the log evidence of SHARES against the stated variance if these have moved; each's cost."""
        _, costs, volumes = zip(*(self.solve(free, share) for share in SHARES), strict=True)
        found = volumes[0] - np.array(volumes)
        return float(found.max() + np.log(np.mean(np.exp(found - found.max())))), np.array(costs)

    def moved(self) -> tuple[list[int], FloatArray]:
        """Return the cameras that have moved, the one that explains most first, and all errors (C, 6).

        If all but one have, nothing shows which one has not, so all are returned. The error of that one is
        estimated in place of the camera that explains least.
        """
        free: list[int] = []
        evidence, costs = self.evidence(free)
        left = often = np.flatnonzero(self.places @ self.compared > OFTEN - 0.5).tolist()
        while left and len(free) < len(self.cameras) - 1:
            best = min(left, key=lambda c: self.solve([*free, c])[1])
            after, fewer = self.evidence([*free, best])
            gains = costs - fewer
            if gains[0] < MOVED and gains[0] + after - evidence < EVIDENT:
                break
            left = [c for c in left if c != best]
            free.append(best)
            evidence, costs = after, fewer
        errors = self.solve(free)[0]
        if free and len(free) == len(often) - 1:
            (last,) = set(often).difference(free)
            errors[last] = self.solve([*free[:-1], last])[0][last]
            free.append(last)
        return free, errors

    @functools.cached_property
    def shares(self) -> FloatArray:
        """Weights (looks, C, C, 6, 6) of each view in the pose that a camera sees minus that of the others.

        NaN where the camera itself or all others see too little.
        """
        every = np.arange(len(self.cameras))
        known = np.repeat(self.known[:, None], len(every), axis=1)
        known[:, every, every] *= 1e-3  # directions the others do not observe come from the camera itself
        result = -np.linalg.solve(known.sum(axis=2, keepdims=True) + _FAINT, known)
        result[:, every, every] += np.eye(6)
        result[~self.compared] = np.nan
        return result

    def misses(self) -> FloatArray:
        """Return the disagreement (looks, C, 2) of each camera with the others' pose [px]; NaN if unknown."""
        off = np.einsum("fckij,fkj->fci", self.shares, self.moved_by)
        return np.asarray((self.across @ off[..., :3, None])[..., 0] * self.focal)

    def noise(self) -> FloatArray:
        """Return the deviations (looks, C) [rad] that the views' own errors give to lengths of `misses`."""
        parts = self.across[:, :, None] @ self.shares[..., :3, :]
        squares = np.einsum("fckij,fkjl,fckil->fc", parts, np.linalg.inv(self.known + _FAINT), parts)
        return np.asarray(np.sqrt(squares))

    def _poses(self, known: FloatArray, seen: FloatArray) -> FloatArray:
        """Return the joint poses (looks, 6) of the object, given the poses (looks, C, 6) that cameras see."""
        joint = known.sum(axis=1) + _FAINT
        pull = np.einsum("fcij,fcj->fi", known, seen)
        return np.asarray(np.linalg.solve(joint, pull[..., None])[..., 0])

    def _equations(self, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the normal equations (6 C, 6 C), (6 C,) of the errors, without their prior."""
        known = (self.share * weights)[..., None, None] * self.known
        joint = known.sum(axis=1) + _FAINT
        pulled = np.einsum("fji,fcjk->fcik", self.lever, known)  # Gᵀ A
        reduced = np.linalg.solve(joint[:, None], known)  # S⁻¹ A
        blocks = -(pulled[:, :, None] @ reduced[:, None] @ self.lever[:, None, None]).sum(axis=0)
        blocks[np.diag_indices(len(self.cameras))] += (pulled @ self.lever[:, None]).sum(axis=0)
        off = self.moved_by - self._poses(known, self.moved_by)[:, None]
        vector = -np.einsum("fcij,fcj->ci", pulled, off)
        return blocks.swapaxes(1, 2).reshape(vector.size, -1), vector.reshape(-1)
