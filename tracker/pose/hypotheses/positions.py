"""Where could the object be? Positions from label maps alone, without a prior.

A grid of points over the arena, each projected once into every camera, votes by how much of the object's
expected area the cameras see around it in face colours. The best are centred on the pixels they gathered.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from tracker.compiled import compiled
from tracker.conventions import Array, FloatArray
from tracker.geometry.lens import project, project_with_jacobian
from tracker.geometry.linear import solve_positive
from tracker.objects.box import Box
from tracker.pose.hypotheses.gather import face_mask, gather

ARENA_RADIUS = 0.235
ARENA_BOTTOM, ARENA_TOP = -0.015, 0.185
"""The space that is searched for the object's centre [m]; real worlds lie up to 6 mm off the table."""

GRID_STEP = 0.02
MIN_VOTE, MIN_SHARE = 0.15, 0.35
"""Least vote of a position: absolute, and as a share of the best."""

CENTRING_ROUNDS = 3
MIN_SEPARATION = 0.035
"""Two positions closer than this [m] count as one."""


@compiled
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


@compiled
def _box_count(integral, u, v, r, width, height):  # type: ignore[no-untyped-def]
    x0, x1 = max(0, int(u - r)), min(width, int(u + r) + 1)
    y0, y1 = max(0, int(v - r)), min(height, int(v + r) + 1)
    if x1 <= x0 or y1 <= y0:
        return 0
    return integral[y1, x1] - integral[y0, x1] - integral[y1, x0] + integral[y0, x0]


@compiled
def _integrals(labels, face_mask, lenses, used, out):  # type: ignore[no-untyped-def]
    for c in range(len(used)):
        width, height = lenses[c].width, lenses[c].height
        for j in range(height):
            row = 0
            for i in range(width):
                row += face_mask[labels[c, j, i]]
                out[c, j + 1, i + 1] = out[c, j, i + 1] + row


@compiled
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


@compiled
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


@compiled
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


def arena_points() -> FloatArray:
    """(N, 3) grid over the arena [m]."""
    xy = np.arange(-ARENA_RADIUS, ARENA_RADIUS + 1e-9, GRID_STEP)
    z = np.arange(ARENA_BOTTOM, ARENA_TOP + 1e-9, GRID_STEP)
    points = np.stack(np.meshgrid(xy, xy, z, indexing="ij"), axis=-1).reshape(-1, 3)
    inside = np.hypot(points[:, 0], points[:, 1]) <= ARENA_RADIUS
    return np.ascontiguousarray(points[inside])


class PositionSearch:
    """Finds where an object could be; holds the tables that this needs, made once for a rig and an object.

    Args:
        lenses: (C,) of LENS, of the label maps.
        box: the object.
    """

    def __init__(self, lenses: Array, box: Box) -> None:
        self.lenses, self.radius = lenses, box.radius
        self.points = arena_points()
        self.table = vote_table(lenses, self.points, self.radius)
        # Cauchy: the mean projected area of a convex body is a quarter of its surface.
        half = box.half
        surface = 8 * (half[0] * half[1] + half[1] * half[2] + half[2] * half[0])
        self.area_share = float(surface / 4 / (4 * self.radius**2))
        self.face_mask = face_mask(box)

    def __call__(self, labels: Array, used: Array, count: int) -> Iterator[FloatArray]:
        """Up to `count` centred positions (3,) [m], best first; each is worked out when it is asked for."""
        scores, stats = np.empty(len(self.points)), np.empty((len(self.lenses), 7, 3))
        vote(labels, self.face_mask, self.lenses, used, self.table, self.area_share, scores)
        least = max(MIN_VOTE, MIN_SHARE * float(scores.max()))
        found: list[FloatArray] = []
        while len(found) < count:
            position = np.empty(3)
            if take_best(self.points, scores, 2 * MIN_SEPARATION, position) < least:
                return
            centre(self.lenses, labels, self.face_mask, used, self.radius, position, CENTRING_ROUNDS, stats)
            if all(np.linalg.norm(position - other) > MIN_SEPARATION for other in found):
                found.append(position)
                yield position
