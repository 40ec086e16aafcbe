"""Where could the object be, and how turned? Hypotheses from label maps alone, without a prior.

Positions: a grid of points over the arena, each projected once into every camera, votes by how much
of the object's expected area the cameras see around it in face colours. The best are centred on the
pixels they gathered. Rotations: an even grid over SO(3) is ranked by which colours each camera should
see, how much of each, and where they lie relative to each other.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numba
import numpy as np

from tracker.conventions import Array, FloatArray
from tracker.pose.grids import ROTATIONS, arena_points, even_rotations
from tracker.pose.lens import project, project_with_jacobian
from tracker.pose.linear import solve_positive
from tracker.pose.views import Box

MIN_VOTE, MIN_SHARE = 0.15, 0.35
"""Least vote of a position: absolute, and as a share of the best."""

CENTRING_ROUNDS = 3
MIN_SEPARATION = 0.035
"""Two positions closer than this [m] count as one."""


@numba.njit(cache=True, nogil=True)
def vote_table(lenses, points, radius):  # type: ignore[no-untyped-def]
    """(N, C, 3): each point's pixel in every camera, and the object's radius there [px], 0 where unseen."""
    table = np.zeros((len(points), len(lenses), 3))
    for p in range(len(points)):
        for c in range(len(lenses)):
            u, v, z = project(lenses, c, points[p, 0], points[p, 1], points[p, 2])
            if z > 0.1 and 0 <= u < lenses[c].width and 0 <= v < lenses[c].height:
                table[p, c, 0], table[p, c, 1] = u, v
                table[p, c, 2] = radius * lenses[c].focal[0] / z
    return table


@numba.njit(cache=True, nogil=True)
def _box_count(integral, u, v, r, width, height):  # type: ignore[no-untyped-def]
    x0, x1 = max(0, int(u - r)), min(width, int(u + r) + 1)
    y0, y1 = max(0, int(v - r)), min(height, int(v + r) + 1)
    if x1 <= x0 or y1 <= y0:
        return 0
    return integral[y1, x1] - integral[y0, x1] - integral[y1, x0] + integral[y0, x0]


@numba.njit(cache=True, nogil=True)
def _integrals(labels, face_mask, lenses, used, out):  # type: ignore[no-untyped-def]
    for c in range(len(used)):
        width, height = lenses[c].width, lenses[c].height
        for j in range(height):
            row = 0
            for i in range(width):
                row += face_mask[labels[c, j, i]]
                out[c, j + 1, i + 1] = out[c, j, i + 1] + row


@numba.njit(cache=True, nogil=True)
def vote(labels, face_mask, lenses, used, table, area_share, scores):  # type: ignore[no-untyped-def]
    """Scores (N,): for each grid point the sum over cameras of how much of the expected area is there.

    area_share: the object's mean projected area over that of the square around its radius. Of two
    boxes, the tight one centres the vote and the wide one bears with what fingers hide.
    """
    height, width = labels.shape[1], labels.shape[2]
    integral = np.zeros((len(used), height + 1, width + 1), np.int32)
    _integrals(labels, face_mask, lenses, used, integral)
    for p in range(len(scores)):
        total, cameras = 0.0, 0
        for c in range(len(used)):
            r = table[p, c, 2]
            if not used[c] or r == 0.0:
                continue
            cameras += 1
            u, v = table[p, c, 0], table[p, c, 1]
            expected = max(area_share * 4.0 * r * r, 1.0)
            w, h = lenses[c].width, lenses[c].height
            wide = _box_count(integral[c], u, v, r, w, h) / expected
            tight = _box_count(integral[c], u, v, 0.6 * r, w, h) / expected
            total += min(wide, 1.0) + min(tight, 1.0)
        # A camera that cannot see the point neither helps nor harms.
        scores[p] = total / max(cameras, 1)


@numba.njit(cache=True, nogil=True)
def take_best(points, scores, radius, out):  # type: ignore[no-untyped-def]
    """Copy the best point (3,) to out, take all within `radius` [m] out of the vote; returns its score."""
    best = 0
    for p in range(len(scores)):
        if scores[p] > scores[best]:
            best = p
    score = scores[best]
    for i in range(3):
        out[i] = points[best, i]
    for p in range(len(scores)):
        distance = 0.0
        for i in range(3):
            distance += (points[p, i] - out[i]) ** 2
        if distance < radius * radius:
            scores[p] = -1.0
    return score


@numba.njit(cache=True, nogil=True)
def gather(lenses, labels, face_mask, used, position, radius, stats):  # type: ignore[no-untyped-def]
    """Stats (C, 7, 3): count, mean column, mean row of each label within `radius` [m] of a position."""
    stats[:] = 0.0
    for c in range(len(used)):
        if not used[c]:
            continue
        u, v, z = project(lenses, c, position[0], position[1], position[2])
        if z < 0.1:
            continue
        r = radius * lenses[c].focal[0] / z
        width, height = lenses[c].width, lenses[c].height
        for j in range(max(0, int(v - r)), min(height, int(v + r) + 2)):
            for i in range(max(0, int(u - r)), min(width, int(u + r) + 2)):
                label = labels[c, j, i]
                if face_mask[label] == 0 or (i - u) ** 2 + (j - v) ** 2 > r * r:
                    continue
                stats[c, label, 0] += 1.0
                stats[c, label, 1] += i
                stats[c, label, 2] += j
        for label in range(1, 7):
            if stats[c, label, 0] > 0:
                stats[c, label, 1] /= stats[c, label, 0]
                stats[c, label, 2] /= stats[c, label, 0]


@numba.njit(cache=True, nogil=True)
def centre(lenses, labels, face_mask, used, radius, position, rounds, stats):  # type: ignore[no-untyped-def]
    """Move a position so that it projects to the centroids of the face pixels around it."""
    jacobian, matrix = np.empty((2, 3)), np.empty((3, 3))
    vector, step = np.empty(3), np.empty(3)
    for _ in range(rounds):
        gather(lenses, labels, face_mask, used, position, radius, stats)
        for i in range(3):
            vector[i] = 0.0
            for k in range(3):
                matrix[i, k] = 2000.0 if i == k else 0.0
        for c in range(len(used)):
            n, su, sv = 0.0, 0.0, 0.0
            for label in range(1, 7):
                n += stats[c, label, 0]
                su += stats[c, label, 0] * stats[c, label, 1]
                sv += stats[c, label, 0] * stats[c, label, 2]
            if n < 1:
                continue
            u, v, _ = project_with_jacobian(lenses, c, position[0], position[1], position[2], jacobian)
            weight = min(n, 100.0) / 100.0
            du, dv = su / n - u, sv / n - v
            for i in range(3):
                vector[i] += weight * (jacobian[0, i] * du + jacobian[1, i] * dv)
                for k in range(3):
                    matrix[i, k] += weight * (
                        jacobian[0, i] * jacobian[0, k] + jacobian[1, i] * jacobian[1, k]
                    )
        solve_positive(matrix, vector, step)
        for i in range(3):
            position[i] += min(0.04, max(-0.04, step[i]))
    gather(lenses, labels, face_mask, used, position, radius, stats)


@numba.njit(cache=True, nogil=True)
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


class Searcher:
    """The tables that a search needs, made once for a rig and an object."""

    def __init__(self, lenses: Array, box: Box) -> None:
        self.lenses, self.box = lenses, box
        half = box.half
        self.radius = float(np.linalg.norm(half))
        self.points = arena_points()
        self.table = vote_table(lenses, self.points, self.radius)
        # Cauchy: the mean projected area of a convex body is a quarter of its surface.
        surface = 8 * (half[0] * half[1] + half[1] * half[2] + half[2] * half[0])
        self.area_share = float(surface / 4 / (4 * self.radius**2))
        self.rotations = even_rotations(ROTATIONS)
        self.face_mask = np.zeros(7, np.int32)
        self.face_mask[box.face_labels] = 1
        self._scores = np.empty(len(self.points))
        self._costs = np.empty(ROTATIONS)
        self.stats = np.empty((len(lenses), 7, 3))

    def positions(self, labels: Array, used: Array, count: int) -> Iterator[FloatArray]:
        """Up to `count` centred positions (3,) [m], best first; each is worked out when it is asked for."""
        scores = self._scores
        vote(labels, self.face_mask, self.lenses, used, self.table, self.area_share, scores)
        least = max(MIN_VOTE, MIN_SHARE * float(scores.max()))
        found: list[FloatArray] = []
        while len(found) < count:
            position = np.empty(3)
            if take_best(self.points, scores, 2 * MIN_SEPARATION, position) < least:
                return
            centre(
                self.lenses, labels, self.face_mask, used, self.radius, position, CENTRING_ROUNDS, self.stats
            )
            if all(np.linalg.norm(position - other) > MIN_SEPARATION for other in found):
                found.append(position)
                yield position

    def rank(
        self, labels: Array, used: Array, position: FloatArray, count: int
    ) -> tuple[FloatArray, FloatArray]:
        """The `count` best rotations (count, 3, 3) at a position and their costs."""
        box = self.box
        gather(self.lenses, labels, self.face_mask, used, position, 1.1 * self.radius, self.stats)
        rank_rotations(
            self.lenses, used, box.half, box.face_labels, position, self.stats, self.rotations, self._costs
        )
        order = np.argpartition(self._costs, count)[:count]
        order = order[np.argsort(self._costs[order], kind="stable")]
        return self.rotations[order], self._costs[order]
