"""What else the pictures may show, and by how much the best fit leads.

To one camera, a pose reversed in depth, or turned about the one face that it sees, looks much the same.
From afar a face looks the same when it is turned away to the other side (Oberkampf, DeMenthon and Davis,
"Iterative pose estimation using coplanar feature points", CVIU 63(3), 1996), and so does a long object
whose near end becomes the far one.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from tracker.conventions import FloatArray
from tracker.geometry import so3
from tracker.pose.fit import Fit
from tracker.pose.hypotheses import apart
from tracker.pose.judge import rank

LEAST, MOST = np.radians((1.0, 35.0))
"""Angles between an axis of the object and the line of sight, or the plane across it, for which the reversed
pose is worth a try [rad]: less is the same pose, more looks different."""

ONE_FACE = 0.5
"""Area of all other faces, of that of one as the camera sees it, up to which that one may be all it knows."""

RECONCILABLE = 16.8
"""Squared distance of two fits of one pose, in standard deviations: 99 % are nearer (χ² of 6)."""

SQUARE = 0.02
"""Relative difference of two edges up to which a face of them is a square."""


def reversed_in_depth(
    rotation: FloatArray, position: FloatArray, half: FloatArray, camera: FloatArray
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Rotations (3, 3) and positions (3,) [m] that a camera at `camera` (3,) can hardly tell from a pose.

    Args:
        rotation: (3, 3) world_from_object.
        position: (3,) of the object [m].
        half: (3,) half edge lengths [m].
        camera: (3,) [m].
    """
    sight = (camera - position) / np.linalg.norm(camera - position)
    for axis in range(3):
        along = rotation[:, axis]
        toward = float(along @ sight)
        across = _cross(along, sight)
        sine = math.sqrt(across @ across)
        angle = np.arctan2(sine, abs(toward))
        if LEAST < angle < MOST:
            # The face toward the camera keeps its middle.
            side = np.sign(toward) * half[axis]
            turn = so3.exp(2.0 * angle * np.sign(toward) * across / sine)
            turned = turn @ rotation
            yield turned, position + side * (along - turned[:, axis])
        elif LEAST < np.pi / 2 - angle < MOST:
            yield so3.exp(-2.0 * (np.pi / 2 - angle) * np.sign(toward) * across / sine) @ rotation, position


def turned_about_face(
    rotation: FloatArray, position: FloatArray, half: FloatArray, camera: FloatArray
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Where a camera at `camera` (3,) sees little but one face: the other turns at which that fits.

    Arguments and what is given as of `reversed_in_depth`.
    """
    sight = rotation.T @ (camera - position)
    sight /= np.linalg.norm(sight)
    area = np.abs(sight) * half.prod() / half
    face = int(np.argmax(area))
    if area.sum() - area[face] > ONE_FACE * area[face]:
        return
    one, other = (half[k] for k in range(3) if k != face)
    square = abs(one - other) < SQUARE * max(one, other)
    axis = np.zeros(3)
    axis[face] = 1.0
    for quarters in (1, 2, 3) if square else (2,):
        yield rotation @ so3.exp(quarters * 0.5 * math.pi * axis), position


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """The cross product of two vectors (3,): NumPy takes ten times as long."""
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def reconcilable(one: Fit, other: Fit) -> bool:
    """Whether two fits may be of one pose, as their covariances have it: then they are no rivals."""
    off = np.concatenate([one.position - other.position, so3.log(one.rotation @ other.rotation.T)])
    covariance = one.covariance + other.covariance
    return bool(np.isfinite(covariance).all() and off @ np.linalg.solve(covariance, off) < RECONCILABLE)


def lead(best: Fit, fits: Sequence[Fit], radius: float) -> float:
    """Log odds of the best fit over all clearly different ones together; infinite where there are none.

    fits: best first; radius: of the object [m].
    """
    different = [best]
    for fit in fits:
        if all(apart(fit, other, radius) for other in different) and not reconcilable(best, fit):
            different.append(fit)
    if len(different) == 1:
        return math.inf
    behind = [rank(best) - rank(rival) for rival in different[1:]]
    least = min(behind)
    return least - math.log(sum(math.exp(least - one) for one in behind))
