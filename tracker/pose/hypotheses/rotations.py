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
    """Costs (n,): misfit of the colours' areas and centroids for every rotation (n, 3, 3).

    This is equation (5) of docs/how-it-works.md.
    stats (C, 7, 3): of the colours around the position, see `gather`.
    """
    jacobian, view, roots = np.empty((2, 3)), np.empty(3), np.empty(7)
    costs[:] = 0.0
    for c in range(len(used)):
        if not used[c]:
            continue
        u, v, z = project_with_jacobian(lenses, c, position[0], position[1], position[2], jacobian)
        if z < 2.0 * max(half[0], half[1], half[2]):
            continue
        per_area = 4.0 * lenses[c].focal[0] * lenses[c].focal[1] / z**2
        distance, unseen = 0.0, 0.0
        for i in range(3):
            view[i] = lenses[c].position[i] - position[i]
            distance += view[i] * view[i]
        distance = math.sqrt(distance)
        for label in range(1, 7):
            roots[label] = math.sqrt(stats[c, label, 0])
        for face in range(6):
            unseen += stats[c, face_labels[face], 0]
        for h in range(len(rotations)):
            # What is seen of faces that should not be, and cannot be explained away; then those that should.
            rotation, cost = rotations[h], unseen
            for axis in range(3):
                cosine = (
                    rotation[0, axis] * view[0] + rotation[1, axis] * view[1] + rotation[2, axis] * view[2]
                )
                if abs(cosine) <= half[axis]:
                    continue
                face, sign = (2 * axis, 1.0) if cosine > 0.0 else (2 * axis + 1, -1.0)
                label = face_labels[face]
                area = half[0] * half[1] * half[2] / half[axis]
                expected = area * per_area * (abs(cosine) - half[axis]) / distance
                seen, gap = stats[c, label, 0], roots[label] - math.sqrt(expected)
                # Fewer pixels than expected may be hidden.
                cost += gap * gap * (0.5 if gap < 0 else 1.0) - seen
                if seen > 0.0:
                    out = sign * half[axis]
                    du, dv = stats[c, label, 1] - u, stats[c, label, 2] - v
                    for i in range(3):
                        du -= out * jacobian[0, i] * rotation[i, axis]
                        dv -= out * jacobian[1, i] * rotation[i, axis]
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
