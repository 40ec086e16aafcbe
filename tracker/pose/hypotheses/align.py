"""Align a hypothesis with the label maps.

Along the normal of each piece of edge the most likely place of the label transition is found (as many pixels
as possible of the face's label inside, and of the neighbour's or none outside); Gauss-Newton with robust
weights moves the pose there.
"""

from __future__ import annotations

import math

import numpy as np

from tracker.compiled import compiled
from tracker.geometry.lens import apply_update
from tracker.geometry.linear import solve_positive
from tracker.pose.edges.strips import MAX_STRIPS, STRIP, edge_strips
from tracker.pose.fit import SEEN
from tracker.pose.hypotheses.explain import explain, explanation_score

SPACING = 2.0
"""Length of the pieces of edge [px of the label map]."""

IMPOSSIBLE = -1e9
"""Score of a hypothesis whose edges are nowhere to be seen."""


@compiled
def _transition(labels, width, height, strip, reach):  # type: ignore[no-untyped-def]
    """Offset along the normal of the label transition, and whether there is one."""
    u, v, nu, nv = strip.pixel[0], strip.pixel[1], strip.normal[0], strip.normal[1]
    inside, outside = strip.inside, strip.outside
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


@compiled
def align(lenses, labels, used, half, face_labels, rotation, position, reaches, strips):  # type: ignore[no-untyped-def]
    """Move the pose in place, a step for each of `reaches` [px]; returns the last step's samples used.

    labels (C, h, w); used (C,) bool: cameras that gave an image.
    """
    matrix, vector, update = np.empty((6, 6)), np.empty(6), np.empty(6)
    radius2 = half[0] ** 2 + half[1] ** 2 + half[2] ** 2
    total = 0
    for step in range(len(reaches)):
        reach = reaches[step]
        matrix[:], vector[:] = 0.0, 0.0
        total = 0
        for c in range(len(used)):
            if not used[c]:
                continue
            width, height = lenses[c].width, lenses[c].height
            n = edge_strips(lenses, c, half, face_labels, rotation, position, SPACING, 1.0, strips)
            for s in range(n):
                strip = strips[s]
                offset, found = _transition(labels[c], width, height, strip, reach)
                if not found:
                    continue
                total += 1
                scale = 0.6 * reach
                weight = 1.0 / (1.0 + (offset / scale) ** 2)
                for i in range(6):
                    vector[i] += weight * strip.jacobian[i] * offset
                    for k in range(i + 1):
                        matrix[i, k] += weight * strip.jacobian[i] * strip.jacobian[k]
        if total < 6:
            return 0
        # A weak prior (1 radius, 0.6 rad against 1 px) keeps unseen directions where they are.
        for i in range(6):
            matrix[i, i] += 1.0 / radius2 if i < 3 else 3.0
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


@compiled
def try_hypotheses(lenses, labels, used, half, face_labels, rotations, positions, reaches, scores):  # type: ignore[no-untyped-def]
    """Align every hypothesis (n, 3, 3), (n, 3) in place and write its score (n,)."""
    strips = np.empty(MAX_STRIPS, STRIP)
    seen = np.zeros(len(used), SEEN)
    for h in range(len(scores)):
        found = align(lenses, labels, used, half, face_labels, rotations[h], positions[h], reaches, strips)
        if found == 0:
            scores[h] = IMPOSSIBLE
            continue
        explain(lenses, labels, used, half, face_labels, rotations[h], positions[h], seen)
        scores[h] = explanation_score(seen)
