"""Align a hypothesis with the label maps, and say how well it explains them.

Alignment: along each edge sample's normal the most likely place of the label transition is found
(as many pixels as possible of the face's label inside, and of the neighbour's or none outside);
Gauss-Newton with robust weights moves the pose there. Explanation: every pixel near the object is
compared with the face that a ray through it meets.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from tracker.pose.edges import COLUMNS, INSIDE, MAX_SAMPLES, NU, NV, OUTSIDE, J, U, V, edge_samples
from tracker.pose.lens import apply_update, project, visible_faces
from tracker.pose.linear import solve_positive

SPACING = 2.0
"""Distance between samples on an edge [px of the label map]."""

AGREE, MISSING, WRONG, EXTRA, PREDICTED = range(5)
"""Columns of a count: face seen as its label, as background, as another face; face label beside the
object; pixels that the object should cover."""

IMPOSSIBLE = -1e9
"""Score of a hypothesis whose edges are nowhere to be seen."""

_LABEL_RIM = 2.5


@numba.njit(cache=True, nogil=True)
def _transition(labels, width, height, u, v, nu, nv, inside, outside, reach):  # type: ignore[no-untyped-def]
    """Offset along the normal of the label transition, and whether there is one."""
    score, best, offset, support = 0.0, -1e9, 0.0, 0
    seen_inside, best_seen = 0, 0
    # Prefix sums of (inside fits) - (outside fits): the maximum is the most likely transition.
    for k in range(-reach, reach + 1):
        i, j = math.floor(u + k * nu + 0.5), math.floor(v + k * nv + 0.5)
        if i < 0 or j < 0 or i >= width or j >= height:
            return 0.0, False
        label = labels[j, i]
        if label == inside:
            score += 1.0
            seen_inside += 1
        elif outside == 0:
            score -= 1.0 if label == 0 else 0.5
        elif label == outside:
            score -= 1.0
            support += 1
        else:
            score -= 0.2
        if score > best:
            best, offset, best_seen = score, k + 0.5, seen_inside
    if best_seen < 2 or offset >= reach:
        return 0.0, False
    if outside > 0 and support < 2:
        return 0.0, False
    return offset, True


@numba.njit(cache=True, nogil=True)
def align(lenses, labels, used, half, face_labels, rotation, position, reaches, samples):  # type: ignore[no-untyped-def]
    """Move the pose in place, a step for each of `reaches` [px]; returns the last step's samples used.

    labels (C, h, w); used (C,) bool: cameras that gave an image.
    """
    matrix, vector, update = np.empty((6, 6)), np.empty(6), np.empty(6)
    total = 0
    for step in range(len(reaches)):
        reach = reaches[step]
        matrix[:], vector[:] = 0.0, 0.0
        total = 0
        for c in range(len(used)):
            if not used[c]:
                continue
            width, height = lenses[c].width, lenses[c].height
            n = edge_samples(lenses, c, half, face_labels, rotation, position, SPACING, 1.0, samples)
            for s in range(n):
                row = samples[s]
                offset, found = _transition(
                    labels[c], width, height, row[U], row[V], row[NU], row[NV],
                    int(row[INSIDE]), int(row[OUTSIDE]), reach,
                )  # fmt: skip
                if not found:
                    continue
                total += 1
                scale = 0.6 * reach
                weight = 1.0 / (1.0 + (offset / scale) ** 2)
                for i in range(6):
                    vector[i] += weight * row[J + i] * offset
                    for k in range(i + 1):
                        matrix[i, k] += weight * row[J + i] * row[J + k]
        if total < 6:
            return 0
        # A weak prior (5 cm, 0.6 rad against 1 px) keeps unseen directions where they are.
        for i in range(6):
            matrix[i, i] += 400.0 if i < 3 else 3.0
            for k in range(i):
                matrix[k, i] = matrix[i, k]
        if not solve_positive(matrix, vector, update):
            return 0
        turn = math.sqrt(update[3] ** 2 + update[4] ** 2 + update[5] ** 2)
        if turn > 0.5:
            for i in range(3, 6):
                update[i] *= 0.5 / turn
        apply_update(rotation, position, update)
    return total


@numba.njit(cache=True, nogil=True)
def explain(lenses, labels, used, half, face_labels, rotation, position, counts):  # type: ignore[no-untyped-def]
    """Compare label maps with the pose: counts (C, 5) of their pixels, see AGREE and below."""
    heights = np.empty(6)
    origin = np.empty(3)
    radius = math.sqrt(half[0] ** 2 + half[1] ** 2 + half[2] ** 2)
    for c in range(len(used)):
        for k in range(5):
            counts[c, k] = 0
        if not used[c]:
            continue
        u0, v0, z = project(lenses, c, position[0], position[1], position[2])
        if z < 0.05:
            continue
        visible_faces(lenses, c, half, rotation, position, heights)
        reach = radius * max(lenses[c].focal[0], lenses[c].focal[1]) / max(z - radius, 0.05) + _LABEL_RIM
        width, height = lenses[c].width, lenses[c].height
        left, right = max(0, int(u0 - reach)), min(width - 1, int(u0 + reach) + 1)
        top, bottom = max(0, int(v0 - reach)), min(height - 1, int(v0 + reach) + 1)
        # A ray's direction is affine in the pixel once the lens is linearised at the object.
        jac = np.empty((2, 2))
        a0, b0 = _normalised(lenses, c, u0, v0)
        a1, b1 = _normalised(lenses, c, u0 + 8.0, v0)
        a2, b2 = _normalised(lenses, c, u0, v0 + 8.0)
        jac[0, 0], jac[1, 0] = (a1 - a0) / 8.0, (b1 - b0) / 8.0
        jac[0, 1], jac[1, 1] = (a2 - a0) / 8.0, (b2 - b0) / 8.0
        r = lenses[c].rotation
        # object_from_camera rotation, so that rays come out in the object's frame.
        m = np.empty((3, 3))
        for i in range(3):
            origin[i] = 0.0
            for k in range(3):
                origin[i] += rotation[k, i] * (lenses[c].position[k] - position[k])
                m[i, k] = rotation[0, i] * r[k, 0] + rotation[1, i] * r[k, 1] + rotation[2, i] * r[k, 2]
        for j in range(top, bottom + 1):
            for i in range(left, right + 1):
                a = a0 + jac[0, 0] * (i - u0) + jac[0, 1] * (j - v0)
                b = b0 + jac[1, 0] * (i - u0) + jac[1, 1] * (j - v0)
                near, far, face = 0.0, 1e9, -1
                for axis in range(3):
                    d = m[axis, 0] * a + m[axis, 1] * b + m[axis, 2]
                    if abs(d) < 1e-9:
                        d = 1e-9
                    t1, t2 = (-half[axis] - origin[axis]) / d, (half[axis] - origin[axis]) / d
                    side = 1
                    if t1 > t2:
                        t1, t2, side = t2, t1, 0
                    if t1 > near:
                        near, face = t1, 2 * axis + side
                    far = min(far, t2)
                label = labels[c, j, i]
                if face >= 0 and near < far:
                    counts[c, PREDICTED] += 1
                    if label == face_labels[face]:
                        counts[c, AGREE] += 1
                    elif label == 0:
                        counts[c, MISSING] += 1
                    else:
                        counts[c, WRONG] += 1
                elif label > 0:
                    counts[c, EXTRA] += 1


@numba.njit(cache=True, nogil=True)
def _normalised(lenses, c, u, v):  # type: ignore[no-untyped-def]
    """Undistorted normalised coordinates of a pixel, by fixed-point iteration."""
    k = lenses[c].distortion
    x0 = (u - lenses[c].center[0]) / lenses[c].focal[0]
    y0 = (v - lenses[c].center[1]) / lenses[c].focal[1]
    a, b = x0, y0
    for _ in range(8):
        s = a * a + b * b
        radial = 1.0 + s * (k[0] + s * (k[1] + s * k[4]))
        da = 2.0 * k[2] * a * b + k[3] * (s + 2.0 * a * a)
        db = k[2] * (s + 2.0 * b * b) + 2.0 * k[3] * a * b
        a, b = (x0 - da) / radial, (y0 - db) / radial
    return a, b


@numba.njit(cache=True, nogil=True)
def explanation_score(counts):  # type: ignore[no-untyped-def]
    """How well a pose explains the label maps; a hidden pixel counts little, a wrong one much."""
    score = 0.0
    for c in range(counts.shape[0]):
        score += counts[c, AGREE] - 0.4 * counts[c, MISSING] - 1.5 * counts[c, WRONG] - 0.7 * counts[c, EXTRA]
    return score


@numba.njit(cache=True, nogil=True)
def try_hypotheses(lenses, labels, used, half, face_labels, rotations, positions, reaches, scores):  # type: ignore[no-untyped-def]
    """Align every hypothesis (n, 3, 3), (n, 3) in place and write its score (n,)."""
    samples = np.empty((MAX_SAMPLES, COLUMNS))
    counts = np.empty((len(used), 5), np.int64)
    for h in range(len(scores)):
        found = align(lenses, labels, used, half, face_labels, rotations[h], positions[h], reaches, samples)
        if found == 0:
            scores[h] = IMPOSSIBLE
            continue
        explain(lenses, labels, used, half, face_labels, rotations[h], positions[h], counts)
        scores[h] = explanation_score(counts)
