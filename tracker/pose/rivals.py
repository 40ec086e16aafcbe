"""Rival poses, and the lead of the best fit over them."""

import math
from collections.abc import Iterator, Sequence

import numpy as np

from tracker.conventions import FloatArray
from tracker.geometry import so3
from tracker.objects.model import Box
from tracker.pose.align import EXPECTED
from tracker.pose.fit import Fit
from tracker.pose.hypotheses import apart
from tracker.pose.judge import rank

ONE_FACE = 0.5
"""Visible area of all other faces, relative to the largest, below which a camera may see only that one."""

RECONCILABLE = 16.8
"""Squared Mahalanobis distance between fits of one pose: 99 % are closer (χ², 6 degrees of freedom)."""

SQUARE = 0.02
"""Relative difference of two edges below which their face counts as a square."""

LONG = 1.5
"""Longest edge, relative to the next, from which a box may be mistaken for one shifted along that edge."""

SHIFTS = (-0.75, -0.5, -0.25, 0.25, 0.5, 0.75)
"""Distances by which it may be shifted [half its longest edge]: a hidden end is easily taken to be where an
occluder ends."""


def turned_about_face(
    rotation: FloatArray, position: FloatArray, half: FloatArray, camera: FloatArray
) -> Iterator[FloatArray]:
    """Yield other rotations (3, 3) that fit equally well if a camera sees little but one face of a box.

    Args:
        rotation: (3, 3) world_from_object.
        position: (3,) of the object [m].
        half: (3,) half edge lengths [m].
        camera: (3,) position of the camera [m].
    """
    sight = (rotation.T @ (camera - position)).tolist()
    area = [abs(along) / size for along, size in zip(sight, half.tolist(), strict=True)]
    face = area.index(max(area))
    if sum(area) > (1.0 + ONE_FACE) * area[face]:
        return
    one, other = (half[k] for k in range(3) if k != face)
    square = abs(one - other) < SQUARE * max(one, other)
    axis = np.zeros(3)
    axis[face] = 1.0
    for quarters in (1, 2, 3) if square else (2,):
        yield rotation @ so3.exp(quarters * 0.5 * math.pi * axis)


def shifted_along(fit: Fit, box: Box) -> Iterator[FloatArray]:
    """Yield other positions (3,) [m] that fit about as well if the ends of a long box are hidden."""
    half, labels = box.half.tolist(), box.face_labels.tolist()
    _, middle, longest = sorted(half)
    if longest < LONG * middle:
        return
    axis = half.index(longest)
    ends, faces = (2 * axis, 2 * axis + 1), fit.cameras["faces"].tolist()
    if all(seen[end][labels[end]] < EXPECTED for seen in faces for end in ends):
        for shift in SHIFTS:
            yield fit.position + shift * box.half[axis] * fit.rotation[:, axis]


def reconcilable(one: Fit, other: Fit) -> bool:
    """Whether two fits may be of one pose, given their covariances; if so, they are not rivals."""
    off = np.concatenate([one.position - other.position, so3.log(one.rotation @ other.rotation.T)])
    covariance = one.covariance + other.covariance
    return bool(np.isfinite(covariance).all() and off @ np.linalg.solve(covariance, off) < RECONCILABLE)


def lead(best: Fit, fits: Sequence[Fit], radius: float) -> float:
    """Log odds of the best fit over all clearly different ones together; infinite if there are none.

    fits: best first; radius: of the object [m].
    """
    different = [best]
    for fit in fits:
        other = fit is not best and all(apart(fit, one, radius) for one in different)
        if other and not reconcilable(best, fit):
            different.append(fit)
    if len(different) == 1:
        return math.inf
    behind = [rank(best) - rank(rival) for rival in different[1:]]
    least = min(behind)
    return least - math.log(sum(math.exp(least - one) for one in behind))
