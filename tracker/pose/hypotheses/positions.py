"""Where could the object be? Positions from label maps alone, without a prior.

Points of a grid over the arena vote by how much of the object's expected area the cameras see around them in
face colours. The grid is searched from coarse to fine: a cell's vote bounds those of all points in it, so
that cells where no camera shows enough are left at once. The best points are centred on the pixels they
gathered.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from tracker.compiled import compiled
from tracker.conventions import Array, FloatArray
from tracker.geometry.arena import Arena
from tracker.geometry.lens import project, project_with_jacobian
from tracker.geometry.linear import solve_positive
from tracker.objects.box import Box
from tracker.pose.hypotheses.gather import face_mask, gather

MIN_VOTE, MIN_SHARE = 0.15, 0.35
"""Least vote of a position: absolute, and as a share of the best."""

ALMOST = 0.95
"""The same where the best alone is wanted."""

DOUBT = 0.5
"""Cameras that are taken to see nothing at a point, beside those that look there."""

STEP = 0.4
"""Distance of the grid's points [radii of the object]."""

BRANCH = 3
"""Parts of a cell along each axis."""

COARSE = 300
"""Cells of the coarsest grid, at most."""

SEPARATION = 0.7
"""Two positions closer than this [radii] count as one."""

CENTRING_ROUNDS = 3

MOST_POINTS = 1 << 13
"""Points whose votes are kept."""


@compiled
def integrate(labels, mask, lenses, used, out):  # type: ignore[no-untyped-def]
    """Out (C, h + 1, w + 1): integral images of the face colours' pixels; returns how many they are."""
    total = 0
    for c in range(len(used)):
        if not used[c]:
            continue
        width, height = lenses[c].width, lenses[c].height
        out[c, 0, : width + 1] = 0
        for j in range(height):
            row = 0
            out[c, j + 1, 0] = 0
            for i in range(width):
                row += mask[labels[c, j, i]]
                out[c, j + 1, i + 1] = out[c, j, i + 1] + row
        total += out[c, height, width]
    return total


@compiled
def _box_count(integral, u, v, ru, rv, width, height):  # type: ignore[no-untyped-def]
    x0, x1 = max(0, int(u - ru)), min(width, int(u + ru) + 1)
    y0, y1 = max(0, int(v - rv)), min(height, int(v + rv) + 1)
    if x1 <= x0 or y1 <= y0:
        return 0
    return integral[y1, x1] - integral[y0, x1] - integral[y1, x0] + integral[y0, x0]


@compiled
def vote(integrals, lenses, used, x, y, z, radius, area_share, slack):  # type: ignore[no-untyped-def]
    """Mean over the cameras that see a point of how much of the object's expected area is around it.

    This is equation (4) of docs/how-it-works.md.
    area_share: the object's mean projected area over that of the square around its radius. Of two boxes, the
    tight one centres the vote and the wide one bears with what fingers hide. With `slack` [m], what any point
    so near has at most.
    """
    certain, number, best, doubtful = 0.0, 0, 0.0, 0
    for c in range(len(used)):
        if not used[c]:
            continue
        u, v, depth = project(lenses, c, x, y, z)
        if depth + slack < 1.5 * radius:
            continue
        near = depth - slack
        if near < 1.5 * radius:
            # Some of the points are too near to this camera; of the others it may see all it can.
            best, doubtful = 2.0, doubtful + 1
            continue
        su, sv = slack * lenses[c].focal[0] / near, slack * lenses[c].focal[1] / near
        width, height = lenses[c].width, lenses[c].height
        if u < -su or v < -sv or u >= width + su or v >= height + sv:
            continue
        ru, rv = radius * lenses[c].focal[0] / near, radius * lenses[c].focal[1] / near
        shrunk = (near / (depth + slack)) ** 2
        expected = max(area_share * 4.0 * ru * rv * shrunk, 1.0)
        wide = _box_count(integrals[c], u, v, ru + su, rv + sv, width, height) / expected
        tight = _box_count(integrals[c], u, v, 0.6 * ru + su, 0.6 * rv + sv, width, height) / expected
        one = min(wide, 1.0) + min(tight, 1.0)
        if su <= u < width - su and sv <= v < height - sv:
            certain += one
            number += 1
        else:
            best, doubtful = max(best, one), doubtful + 1
    # A camera that cannot see the point does not count, but the more agree the better; those that may see
    # it, help a bound only.
    mean = certain / (number + DOUBT)
    return max(mean, (certain + doubtful * best) / (number + doubtful + DOUBT)) if best > 0.0 else mean


@compiled
def search(integrals, lenses, used, cells, size, leaf, inside, radius, area_share, share, points, scores):  # type: ignore[no-untyped-def]
    """Fill points (N, 3), scores (N,) with the votes that may count; returns how many they are.

    cells (M, 3): centres of the coarsest cells; size, leaf: edge of these and of the finest ones [m]; inside:
    centre x, y, radius, bottom and top of the arena [m]; share: least vote, of the best one.
    """
    stack, sizes = np.empty((len(cells) + 400, 3)), np.empty(len(cells) + 400)
    bounds, order = np.empty(len(cells)), np.empty(len(cells))
    for k in range(len(cells)):
        bounds[k] = vote(
            integrals, lenses, used, cells[k, 0], cells[k, 1], cells[k, 2], radius, area_share,
            0.87 * size,
        )  # fmt: skip
    count, best, top = 0, 0.0, 0
    # The most promising cells come last, and so are looked into first.
    for k in range(len(cells)):
        if bounds[k] >= MIN_VOTE:
            place = top
            while place > 0 and order[place - 1] > bounds[k]:
                order[place] = order[place - 1]
                for i in range(3):
                    stack[place, i] = stack[place - 1, i]
                place -= 1
            order[place], sizes[top] = bounds[k], size
            for i in range(3):
                stack[place, i] = cells[k, i]
            top += 1
    while top > 0:
        top -= 1
        x, y, z, edge = stack[top, 0], stack[top, 1], stack[top, 2], sizes[top]
        if edge <= 1.01 * leaf:
            far = math.hypot(x - inside[0], y - inside[1])
            if far > inside[2] or z < inside[3] or z > inside[4]:
                continue
            score = vote(integrals, lenses, used, x, y, z, radius, area_share, 0.0)
            if score >= max(MIN_VOTE, share * best) and count < len(scores):
                points[count, 0], points[count, 1], points[count, 2], scores[count] = x, y, z, score
                count += 1
                best = max(best, score)
            continue
        bound = vote(integrals, lenses, used, x, y, z, radius, area_share, 0.87 * edge)
        if bound < max(MIN_VOTE, share * best) or top + BRANCH**3 > len(sizes):
            continue
        part = edge / BRANCH
        for i in range(BRANCH**3):
            stack[top, 0] = x + (i % BRANCH - 1) * part
            stack[top, 1] = y + (i // BRANCH % BRANCH - 1) * part
            stack[top, 2] = z + (i // BRANCH**2 - 1) * part
            sizes[top] = part
            top += 1
    return count


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
def centre(lenses, labels, mask, used, radius, position, rounds, stats):  # type: ignore[no-untyped-def]
    """Move a position so that it projects to the centroids of the face pixels around it."""
    jacobian, matrix = np.empty((2, 3)), np.empty((3, 3))
    vector, step = np.empty(3), np.empty(3)
    for _ in range(rounds):
        gather(lenses, labels, mask, used, position, radius, stats)
        for i in range(3):
            vector[i] = 0.0
            for k in range(3):
                # A prior of 0.45 radii against a pixel.
                matrix[i, k] = 5.0 / radius**2 if i == k else 0.0
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
            position[i] += min(0.8 * radius, max(-0.8 * radius, step[i]))
    gather(lenses, labels, mask, used, position, radius, stats)


def _cells(arena: Arena, leaf: float, bottom: float, top: float) -> tuple[FloatArray, float]:
    """Centres (M, 3) of few cells that cover the arena, and their edge [m], a power of BRANCH leaves."""
    size = leaf
    while True:
        across, up = math.ceil(2 * arena.radius / size), math.ceil((top - bottom) / size)
        if across * across * up <= COARSE:
            break
        size *= BRANCH
    side = (np.arange(across) - (across - 1) / 2) * size
    heights = (bottom + top) / 2 + (np.arange(up) - (up - 1) / 2) * size
    x, y, z = np.meshgrid(side + arena.center[0], side + arena.center[1], heights, indexing="ij")
    return np.stack([x, y, z], axis=-1).reshape(-1, 3), size


class PositionSearch:
    """Finds where an object could be.

    Args:
        lenses: (C,) of LENS, of the label maps.
        box: the object.
        arena: where its centre may be.
    """

    def __init__(self, lenses: Array, box: Box, arena: Arena) -> None:
        self.lenses, self.radius = lenses, box.radius
        # Cauchy: the mean projected area of a convex body is a quarter of its surface.
        half = box.half
        surface = 8 * (half[0] * half[1] + half[1] * half[2] + half[2] * half[0])
        self.area_share = float(surface / 4 / (4 * self.radius**2))
        self.face_mask = face_mask(box)
        bottom, top = arena.lowest, arena.ground + arena.height
        self._leaf = STEP * self.radius
        self._cells, self._size = _cells(arena, self._leaf, bottom, top)
        self._inside = np.array([*arena.center, arena.radius, bottom, top])

    def integrals(self, labels: Array, used: Array) -> tuple[Array, int]:
        """Integral images of the face colours in label maps (C, h, w), and their number of pixels."""
        count, height, width = labels.shape
        integrals = np.empty((count, height + 1, width + 1), np.int32)
        return integrals, int(integrate(labels, self.face_mask, self.lenses, used, integrals))

    def positions(self, labels: Array, integrals: Array, used: Array, most: int) -> Iterator[FloatArray]:
        """Up to `most` centred positions (3,) [m], best first; each is worked out when it is asked for."""
        points, scores = self._votes(integrals, used, ALMOST)
        stats = np.empty((len(self.lenses), 7, 3))
        least = max(MIN_VOTE, MIN_SHARE * float(scores.max(initial=0.0)))
        separation = SEPARATION * self.radius
        found: list[FloatArray] = []
        all_votes = False
        while len(found) < most:
            position = np.empty(3)
            if found and not all_votes:
                # Few ask for more than the best.
                points, scores = self._votes(integrals, used, MIN_SHARE)
                take_best(points, scores, 2 * separation, position)
                all_votes = True
            if len(scores) == 0 or take_best(points, scores, 2 * separation, position) < least:
                return
            centre(self.lenses, labels, self.face_mask, used, self.radius, position, CENTRING_ROUNDS, stats)
            if all(np.linalg.norm(position - other) > separation for other in found):
                found.append(position)
                yield position

    def _votes(self, integrals: Array, used: Array, share: float) -> tuple[FloatArray, FloatArray]:
        """Points (N, 3) [m] whose votes (N,) are at least a share of the best one's."""
        points, scores = np.empty((MOST_POINTS, 3)), np.empty(MOST_POINTS)
        count = search(
            integrals, self.lenses, used, self._cells, self._size, self._leaf, self._inside, self.radius,
            self.area_share, share, points, scores,
        )  # fmt: skip
        return points[:count], scores[:count]
