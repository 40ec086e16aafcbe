"""Candidate rotations from the colours around a position.

An even grid over SO(3) is ranked by which colours each camera should see, how much of each, and where they
lie relative to each other.
"""

import functools
import math

import numpy as np

from tracker.compiled import compiled
from tracker.conventions import Array, FloatArray
from tracker.geometry import so3
from tracker.geometry.lens import may_see, project_with_jacobian
from tracker.geometry.linear import smallest
from tracker.pose.strips import SUMS
from tracker.pose.votes import gather

ROTATIONS = 1400
"""Number of rotations in the even grid: the nearest to any rotation is within 18°, on average 11°."""

APART = math.radians(30)
"""Smallest angle between candidates [rad]: alignment corrects smaller ones."""


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
    return so3.matrix_from_quaternion(quaternions)


@compiled(fastmath=SUMS)
def _add_costs(axis, faces, rotations, costs):  # type: ignore[no-untyped-def]
    """Add to costs (n,) one camera's misfit of the two faces across an axis, for rotations (3, 3, n).

    This is equation (5) of docs/how-it-works.md.
    faces (6, 8), in single precision: row 0, the vector to the camera, half the edge, and pixels per metre
    above the face; rows 0 and 1, columns 5 to 7, the pixels seen of each face, their square root, and the
    weight of their centroid; rows 2 and 3, the projection's derivatives; rows 4 and 5, each face's centroid
    minus the box's centre [px].
    """
    vx, vy, vz, half, scale = faces[0, 0], faces[0, 1], faces[0, 2], faces[0, 3], faces[0, 4]
    ax, ay, az, bx, by, bz = faces[2, 0], faces[2, 1], faces[2, 2], faces[3, 0], faces[3, 1], faces[3, 2]
    seen_f, seen_b, root_f, root_b = faces[0, 5], faces[1, 5], faces[0, 6], faces[1, 6]
    sure_f, sure_b = faces[0, 7], faces[1, 7]
    u_f, v_f, u_b, v_b = faces[4, 0], faces[4, 1], faces[5, 0], faces[5, 1]
    zero, one, small = np.float32(0.0), np.float32(1.0), np.float32(0.5)
    for h in range(np.uint64(len(costs))):
        x, y, z = rotations[axis, 0, h], rotations[axis, 1, h], rotations[axis, 2, h]
        cosine = x * vx + y * vy + z * vz
        front = cosine > zero
        height = abs(cosine) - half
        expected = scale * max(height, zero)
        seen, out = seen_f if front else seen_b, half if front else -half
        gap = (root_f if front else root_b) - np.sqrt(expected)
        du = (u_f if front else u_b) - out * (ax * x + ay * y + az * z)
        dv = (v_f if front else v_b) - out * (bx * x + by * y + bz * z)
        # Pixels that are missing may be hidden.
        cost = gap * gap * (small if gap < zero else one) - seen
        cost += (sure_f if front else sure_b) * min(seen, expected) * (du * du + dv * dv)
        costs[h] += cost if height > zero else zero


@compiled
def rank_rotations(lenses, pictures, box, position, stats, rotations, costs):  # type: ignore[no-untyped-def]
    """Costs (n,), single precision: misfit of the colours' areas and centroids for rotations (3, 3, n).

    stats (C, 7, 3): of the colours around the position, see `gather`; rotations: of the object, by axis and
    its components in the world.
    """
    half, face_labels = box
    jacobian, view, faces = np.empty((2, 3)), np.empty(3), np.zeros((6, 8), np.float32)
    radius = math.sqrt(half[0] ** 2 + half[1] ** 2 + half[2] ** 2)
    costs[:] = np.float32(0.0)
    for c in range(len(pictures)):
        if not pictures[c].used or not may_see(lenses, c, position, radius):
            continue
        u, v, z = project_with_jacobian(lenses, c, position[0], position[1], position[2], jacobian)
        if z < 2.0 * max(half[0], half[1], half[2]):
            continue
        per_area = 4.0 * lenses[c].focal[0] * lenses[c].focal[1] / z**2
        distance = 0.0
        for i in range(3):
            view[i] = lenses[c].position[i] - position[i]
            distance += view[i] * view[i]
        distance = math.sqrt(distance)
        for axis in range(3):
            area = half[0] * half[1] * half[2] / half[axis]
            for side in range(2):
                one = stats[c, face_labels[2 * axis + side]]
                for i in range(3):
                    faces[0, i], faces[2, i], faces[3, i] = view[i], jacobian[0, i], jacobian[1, i]
                faces[0, 3], faces[0, 4] = half[axis], area * per_area / distance
                # No more of a colour counts than its face can show: the rest is something else.
                count = min(one[0], area * per_area)
                faces[side, 5], faces[side, 6], faces[side, 7] = count, math.sqrt(count), 0.5 / (one[0] + 4.0)
                faces[4 + side, 0], faces[4 + side, 1] = one[1] - u, one[2] - v
            _add_costs(axis, faces, rotations, costs)


@compiled
def likely_rotations(lenses, labels, pictures, box, position, grid, out):  # type: ignore[no-untyped-def]
    """Fill out (count, 3, 3) with the rotations of a grid that fit the colours around a position best.

    They are at least APART from each other. grid: see `rotation_grid`.
    """
    rotations, single, near = grid
    half, _ = box
    stats, costs = np.empty((len(pictures), 7, 3)), np.empty(len(rotations), np.float32)
    radius = math.sqrt(half[0] ** 2 + half[1] ** 2 + half[2] ** 2)
    gather(lenses, labels, pictures, position, 1.1 * radius, stats)
    rank_rotations(lenses, pictures, box, position, stats, single, costs)
    for k in range(len(out)):
        best = smallest(costs)
        for i in range(9):
            out[k, i // 3, i % 3] = rotations[best, i // 3, i % 3]
        for h in near[best]:
            costs[h] = np.inf


@functools.lru_cache(maxsize=1)
def rotation_grid() -> tuple[FloatArray, Array, Array]:
    """The even grid (n, 3, 3), for each axis its components (3, 3, n) in single precision, and neighbours.

    Neighbours (n, k) are the rotations nearer than APART; where there are fewer than k, the first repeats.
    """
    rotations = even_rotations(ROTATIONS)
    flat = rotations.reshape(ROTATIONS, 9)
    # The trace of R R2ᵀ is 1 + 2 cos of the angle between them.
    close = flat @ flat.T > 1 + 2 * math.cos(APART)
    rows, columns = np.nonzero(close)
    counts = np.bincount(rows)
    k = np.arange(counts.max())
    near = columns[np.cumsum(counts)[:, None] - counts[:, None] + np.where(k < counts[:, None], k, 0)]
    single = np.ascontiguousarray(rotations.transpose(2, 1, 0).astype(np.float32))
    return rotations, single, near
