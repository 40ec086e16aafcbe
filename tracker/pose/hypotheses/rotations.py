"""How could the object be turned? Rotations from the colours around a position.

An even grid over SO(3) is ranked by which colours each camera should see, how much of each, and where they
lie relative to each other.
"""

from __future__ import annotations

import math

import numpy as np

from tracker.compiled import compiled
from tracker.conventions import Array, FloatArray
from tracker.geometry import so3
from tracker.geometry.lens import project_with_jacobian
from tracker.objects.box import Box
from tracker.pose.hypotheses.gather import face_mask, gather

ROTATIONS = 1400
"""Rotations of the even grid: neighbours are about 22° apart."""


def even_rotations(count: int) -> FloatArray:
    """(count, 3, 3) rotations spread evenly over SO(3).

    Super-Fibonacci spirals: M. Alexa, "Super-Fibonacci Spirals: Fast, Low-Discrepancy Sampling of
    SO(3)", CVPR 2022.
    """
    phi, psi = math.sqrt(2.0), 1.533751168755204288118041
    s = np.arange(count) + 0.5
    r, big_r = np.sqrt(s / count), np.sqrt(1 - s / count)
    alpha, beta = 2 * np.pi * s / phi, 2 * np.pi * s / psi
    quaternions = np.stack(
        [r * np.sin(alpha), r * np.cos(alpha), big_r * np.sin(beta), big_r * np.cos(beta)], axis=1
    )
    return np.ascontiguousarray([so3.matrix_from_quaternion(q) for q in quaternions])


@compiled
def rank_rotations(lenses, used, half, face_labels, position, stats, rotations, costs):  # type: ignore[no-untyped-def]
    """Costs (n,): misfit of the colours' areas and centroids for every rotation (n, 3, 3)."""
    jacobian = np.empty((2, 3))
    costs[:] = 0.0
    areas = np.empty(3)
    areas[0], areas[1], areas[2] = half[1] * half[2], half[0] * half[2], half[0] * half[1]
    for c in range(len(used)):
        if not used[c]:
            continue
        u, v, z = project_with_jacobian(lenses, c, position[0], position[1], position[2], jacobian)
        if z < 0.1:
            continue
        per_metre = lenses[c].focal[0] / z
        view = np.empty(3)
        distance = 0.0
        for i in range(3):
            view[i] = lenses[c].position[i] - position[i]
            distance += view[i] * view[i]
        distance = math.sqrt(distance)
        for h in range(len(rotations)):
            rotation = rotations[h]
            cost = 0.0
            for axis in range(3):
                cosine = (
                    rotation[0, axis] * view[0] + rotation[1, axis] * view[1] + rotation[2, axis] * view[2]
                )
                for side in range(2):
                    face = 2 * axis + side
                    sign = 1.0 - 2.0 * side
                    label = face_labels[face]
                    height = max(0.0, (sign * cosine - half[axis]) / distance)
                    expected = 4.0 * areas[axis] * per_metre * per_metre * height
                    seen = stats[c, label, 0]
                    gap = math.sqrt(seen) - math.sqrt(expected)
                    # Fewer pixels than expected may be hidden; more cannot be explained away.
                    cost += gap * gap * (0.5 if gap < 0 else 1.0)
                    if seen > 0 and expected > 0:
                        ou = (
                            (
                                jacobian[0, 0] * rotation[0, axis]
                                + jacobian[0, 1] * rotation[1, axis]
                                + jacobian[0, 2] * rotation[2, axis]
                            )
                            * sign
                            * half[axis]
                        )
                        ov = (
                            (
                                jacobian[1, 0] * rotation[0, axis]
                                + jacobian[1, 1] * rotation[1, axis]
                                + jacobian[1, 2] * rotation[2, axis]
                            )
                            * sign
                            * half[axis]
                        )
                        du, dv = stats[c, label, 1] - u - ou, stats[c, label, 2] - v - ov
                        cost += 0.5 * min(seen, expected) * (du * du + dv * dv) / (seen + 4.0)
            costs[h] += cost


class RotationSearch:
    """Finds how an object could be turned; holds the tables that this needs.

    Args:
        lenses: (C,) of LENS, of the label maps.
        box: the object.
    """

    def __init__(self, lenses: Array, box: Box) -> None:
        self.lenses, self.box = lenses, box
        self.rotations = even_rotations(ROTATIONS)
        self.face_mask = face_mask(box)

    def __call__(
        self, labels: Array, used: Array, position: FloatArray, count: int
    ) -> tuple[FloatArray, FloatArray]:
        """The `count` best rotations (count, 3, 3) at a position and their costs."""
        box, costs = self.box, np.empty(ROTATIONS)
        stats = np.empty((len(self.lenses), 7, 3))
        gather(self.lenses, labels, self.face_mask, used, position, 1.1 * box.radius, stats)
        rank_rotations(self.lenses, used, box.half, box.face_labels, position, stats, self.rotations, costs)
        order = np.argpartition(costs, count)[:count]
        order = order[np.argsort(costs[order], kind="stable")]
        return self.rotations[order], costs[order]
