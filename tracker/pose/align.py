"""Align a hypothesis with the label maps, and count how well it explains them.

Along the normal of each piece of edge, find the most likely label transition: the place with as many pixels
as possible of the face's label inside, and of the neighbour's label or background outside. Gauss-Newton with
robust weights moves the pose there. Then compare each pixel near the object with the face that covers it.
"""

import math

import numpy as np

from tracker.compiled import compiled
from tracker.geometry.cuboid import FACE_CORNERS
from tracker.geometry.lens import apply_update, clamped, copy_pose, face_heights, project, project_corners
from tracker.geometry.linear import solve_positive
from tracker.objects.labels import UNKNOWN
from tracker.pose.fit import SEEN
from tracker.pose.strips import MAX_STRIPS, STRIP, edge_strips

SPACING = 3.0
"""Length of a piece of edge [px of the label map]."""

HIDDEN = 0.4
"""Cost of a hidden pixel, relative to the gain of one that shows the right face."""

FEWEST_PIECES = 4
"""Minimum number of pieces of edge to align a pose, and of those that show an image's blur to measure it."""

EXPECTED = 20
"""Number of pixels that the object should fill in a camera's label map for the camera to count: with fewer it
counts little here, and not at all when a fit is judged. So many pixels in the object's colours, over all
label maps, begin a search, and so many show a long box's end."""

IMPOSSIBLE = -1e9
"""Score of a hypothesis none of whose edges are found."""

BORDER = 2.5
"""Width of the margin around the object in which face colours count as beside it [px of the label map]."""

WHOLLY = 0.5
"""Distance from a face's outline [px of the label map] beyond which a pixel of a sharp image shows this face
alone; in a blurred one, it must be at least the blur's standard deviation."""


@compiled
def _count_face(labels, pixels, face, area, wholly, counts, inner):  # type: ignore[no-untyped-def]
    """Fill counts (8,): pixels of one face by the label they show; the last entry counts unknown ones.

    inner (7,), initially zero, receives the known ones that lie more than `wholly` inside. pixels (8, 3): the
    projected corners; those of a visible face run counter-clockwise in the image.
    """
    left, right, top, bottom = area
    counts[:] = 0
    first, last, sides = bottom, top, np.empty((4, 5))
    for k in range(4):
        a, b = FACE_CORNERS[face, k], FACE_CORNERS[face, (k + 1) % 4]
        u, v = pixels[a, 0], pixels[a, 1]
        across, down = pixels[b, 0] - u, pixels[b, 1] - v
        if down == 0.0:  # a level side bounds no row
            down = 1e-9
        sides[k, 0], sides[k, 1], sides[k, 2], sides[k, 3] = u, v, across / down, down
        sides[k, 4] = wholly * math.sqrt(across**2 + down**2) / down
        row = min(max(v, top - 1.0), bottom + 1.0)
        first, last = min(first, math.ceil(row)), max(last, math.floor(row))
    for j in range(max(first, top), min(last, bottom) + 1):
        low, high, inner_low, inner_high = left - 1.0, right + 1.0, left - 1.0, right + 1.0
        for k in range(4):
            u, within = sides[k, 0] + (j - sides[k, 1]) * sides[k, 2], sides[k, 4]
            if sides[k, 3] > 0.0:
                low, inner_low = max(low, u), max(inner_low, u + within)
            else:
                high, inner_high = min(high, u), min(inner_high, u + within)
        start = max(math.ceil(min(low, right + 1.0)), left)
        for i in range(start, max(start, math.ceil(max(high, left - 1.0)))):
            label = min(labels[np.uint64(j), np.uint64(i)], 7)
            counts[label] += 1
            if inner_low <= i <= inner_high and label < 7:
                inner[label] += 1


@compiled
def _count_camera(lenses, c, labels, box, rotation, position, wholly, one):  # type: ignore[no-untyped-def]
    """Compare camera c's label map (h, w) with a pose, and add up its pixels in the record `one` (SEEN).

    The record's counts must be zero. Outlines of faces are taken to be straight between their corners.
    box: half edge lengths (3,) [m] and labels of the faces (6,).
    """
    half, face_labels = box
    heights, pixels = np.empty(6), np.empty((8, 3))
    radius = math.sqrt(half[0] ** 2 + half[1] ** 2 + half[2] ** 2)
    u0, v0, z = project(lenses, c, position[0], position[1], position[2])
    if z < 1.5 * radius:
        return
    project_corners(lenses, c, half, rotation, position, pixels)
    face_heights(lenses, c, half, rotation, position, heights)
    reach = radius * max(lenses[c].focal[0], lenses[c].focal[1]) / (z - radius) + BORDER
    width, height = lenses[c].width, lenses[c].height
    left, right = clamped(u0 - reach, width), min(width - 1, clamped(u0 + reach, width) + 1)
    top, bottom = clamped(v0 - reach, height), min(height - 1, clamped(v0 + reach, height) + 1)
    area, colored, counts = (left, right, top, bottom), 0, np.empty(8, np.int64)
    for j in range(top, bottom + 1):
        for label in labels[j, left : right + 1]:
            colored += 0 < label < UNKNOWN
    for face in range(6):
        if heights[face] > 0.0:
            _count_face(labels, pixels, face, area, wholly, counts, one.inner[face])
            covered, agree = 0, counts[face_labels[face]]
            for label in range(7):
                one.faces[face, label] = counts[label]
                covered += counts[label] if label > 0 else 0
            one.predicted += covered + counts[0]
            one.agree += agree
            one.missing += counts[0]
            one.wrong += covered - agree
            colored -= covered
    one.extra = colored


@compiled
def count_labels(lenses, labels, pictures, box, rotation, position, lags, seen):  # type: ignore[no-untyped-def]
    """Fill seen (C,) of SEEN with counts of what label maps (C, h, w) show of a pose (3, 3), (3,) [m].

    pictures (C,) of PICTURE; box as in `_count_camera`; lags (C, 6): displacements of the object in the
    cameras' views [m, rad].
    """
    turned, moved = np.empty((3, 3)), np.empty(3)
    for c in range(len(seen)):
        one = seen[c]
        one.predicted, one.agree, one.missing, one.wrong, one.extra = 0, 0, 0, 0, 0
        one.faces[:, :], one.inner[:, :] = 0, 0
        if not pictures[c].used:
            one.elsewhere = pictures[c].colored
            continue
        copy_pose(rotation, position, turned, moved)
        apply_update(turned, moved, lags[c])
        wholly = max(WHOLLY, one.blur * lenses[c].width / pictures[c].width)
        _count_camera(lenses, c, labels[c], box, turned, moved, wholly, one)
        one.elsewhere = pictures[c].colored - one.agree - one.wrong - one.extra


@compiled
def explanation_score(seen, pictures):  # type: ignore[no-untyped-def]
    """How well a pose explains the label maps of the pictures (C,) that count.

    This is equation (6) of docs/how-it-works.md.
    A hidden pixel costs little, a wrong one much; but a camera that shows something else scores no worse than
    one from which the object is hidden.
    """
    score = 0.0
    for c in range(len(seen)):
        one = seen[c]
        explained = one.agree - HIDDEN * one.missing - 1.5 * one.wrong - 0.7 * one.extra
        if pictures[c].used:
            score += max(0.0, HIDDEN + explained / (one.predicted + EXPECTED))
    return score


@compiled
def _transition(labels, width, height, strip, reach):  # type: ignore[no-untyped-def]
    """Return the offset of the label transition along the normal [px], and whether there is one."""
    u, v, nu, nv = strip.pixel[0], strip.pixel[1], strip.normal[0], strip.normal[1]
    inside, outside = strip.inside, strip.outside
    score, best, offset, support = 0.0, -1e9, 0.0, 0
    seen_inside, best_seen = 0, 0
    for k in (-reach, reach):
        if not (0.0 <= u + k * nu + 0.5 < width and 0.0 <= v + k * nv + 0.5 < height):
            return 0.0, False
    # Prefix sums of (inside fits) - (outside fits): the maximum is the most likely transition.
    for k in range(-reach, reach + 1):
        # Unsigned, since a signed index could count from the end.
        label = labels[np.uint32(np.int32(v + k * nv + 0.5)), np.uint32(np.int32(u + k * nu + 0.5))]
        if label == inside:
            score += 1.0
            seen_inside += 1
        elif outside == 0:
            score -= 1.0 if label == 0 or label == UNKNOWN else 0.5
        elif label == outside:
            score -= 1.0
            support += 1
        if score > best:
            best, offset, best_seen = score, k + 0.5, seen_inside
    return offset, best_seen >= 2 and offset < reach and (outside == 0 or support >= 2)


@compiled
def align(lenses, labels, pictures, box, rotation, position, reaches, strips):  # type: ignore[no-untyped-def]
    """Move the pose in place, one step per entry of `reaches` [px]; return whether enough edges are found.

    labels (C, h, w); pictures (C,) of PICTURE; box: half edge lengths (3,) [m] and labels of the faces (6,).
    """
    half, face_labels = box
    matrix, vector, update = np.empty((6, 6)), np.empty(6), np.empty(6)
    radius2 = half[0] ** 2 + half[1] ** 2 + half[2] ** 2
    for reach in reaches:
        matrix[:], vector[:] = 0.0, 0.0
        total = 0
        for c in range(len(pictures)):
            if not pictures[c].used:
                continue
            width, height = lenses[c].width, lenses[c].height
            n = edge_strips(lenses, c, half, face_labels, rotation, position, SPACING, 1.0, strips)
            for s in range(n):
                strip = strips[s]
                offset, found = _transition(labels[c], width, height, strip, reach)
                if not found:
                    continue
                total += 1
                weight = 1.0 / (1.0 + (offset / (0.6 * reach)) ** 2)
                for i in range(6):
                    vector[i] += weight * strip.jacobian[i] * offset
                    for k in range(i + 1):
                        matrix[i, k] += weight * strip.jacobian[i] * strip.jacobian[k]
        if total < FEWEST_PIECES:
            return False
        # A weak prior (1 radius, 0.6 rad against 1 px) keeps the pose in place along unobserved directions.
        for i in range(6):
            matrix[i, i] += 1.0 / radius2 if i < 3 else 3.0
        if not solve_positive(matrix, vector, update):
            return False
        turn = math.sqrt(update[3] ** 2 + update[4] ** 2 + update[5] ** 2)
        if turn > 0.5:
            for i in range(3, 6):
                update[i] *= 0.5 / turn
        apply_update(rotation, position, update)
    return True


@compiled
def try_hypotheses(lenses, labels, pictures, judges, box, rotations, positions, reaches, scores):  # type: ignore[no-untyped-def]
    """Align hypotheses (n, 3, 3), (n, 3) in place to `pictures` (C,); fill scores (n,) by `judges` (C,).

    Without reaches (S,), they stay where they are.
    """
    strips, seen = np.empty(MAX_STRIPS, STRIP), np.zeros(len(pictures), SEEN)
    lags = np.zeros((len(pictures), 6))
    for h in range(len(scores)):
        scores[h], rotation, position = IMPOSSIBLE, rotations[h], positions[h]
        if align(lenses, labels, pictures, box, rotation, position, reaches, strips):
            count_labels(lenses, labels, judges, box, rotation, position, lags, seen)
            scores[h] = explanation_score(seen, judges)
