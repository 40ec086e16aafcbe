"""How well a pose explains the label maps: each pixel near the object against the face that covers it."""

from __future__ import annotations

import math

import numpy as np

from tracker.compiled import compiled
from tracker.geometry.cuboid import CORNER_SIGNS, FACE_CORNERS
from tracker.geometry.lens import project, visible_faces

RIM = 2.5
"""Pixels of the label map around the object, in which colours beside it are counted."""

_SIGNS, _FACES = CORNER_SIGNS, FACE_CORNERS


@compiled
def _face_row(pixels, face, row):  # type: ignore[no-untyped-def]
    """The columns from … to that a face covers in a row of pixels; its corners' pixels are rows of (8, 2)."""
    low, high = 1e9, -1e9
    for k in range(4):
        a, b = _FACES[face, k], _FACES[face, (k + 1) % 4]
        va, vb = pixels[a, 1], pixels[b, 1]
        if (va <= row) == (vb <= row):
            continue
        u = pixels[a, 0] + (row - va) / (vb - va) * (pixels[b, 0] - pixels[a, 0])
        low, high = min(low, u), max(high, u)
    return low, high


@compiled
def _count_face(labels, pixels, face, label, left, right, top, bottom, seen):  # type: ignore[no-untyped-def]
    """Add the pixels of one face to `seen`; returns how many of them have a face's colour."""
    colored, first, last = 0, bottom, top
    for k in range(4):
        first = min(first, math.ceil(pixels[_FACES[face, k], 1]))
        last = max(last, math.floor(pixels[_FACES[face, k], 1]))
    for j in range(max(first, top), min(last, bottom) + 1):
        low, high = _face_row(pixels, face, j)
        for i in range(max(left, math.ceil(low)), min(right, math.ceil(high) - 1) + 1):
            found = labels[j, i]
            seen.predicted += 1
            if found == label:
                seen.agree += 1
            elif found == 0:
                seen.missing += 1
            else:
                seen.wrong += 1
            colored += found > 0
    return colored


@compiled
def explain(lenses, labels, used, half, face_labels, rotation, position, seen):  # type: ignore[no-untyped-def]
    """Compare label maps with the pose: numbers of their pixels into seen (C,) of SEEN.

    The outline of a face is taken to be straight between its corners.
    """
    heights, pixels = np.empty(6), np.empty((8, 2))
    radius = math.sqrt(half[0] ** 2 + half[1] ** 2 + half[2] ** 2)
    for c in range(len(used)):
        one = seen[c]
        one.predicted, one.agree, one.missing, one.wrong, one.extra = 0, 0, 0, 0, 0
        if not used[c]:
            continue
        u0, v0, z = project(lenses, c, position[0], position[1], position[2])
        if z < 1.5 * radius:
            continue
        for k in range(8):
            x, y, w = _SIGNS[k, 0] * half[0], _SIGNS[k, 1] * half[1], _SIGNS[k, 2] * half[2]
            pixels[k, 0], pixels[k, 1], _ = project(
                lenses, c,
                position[0] + rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2] * w,
                position[1] + rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2] * w,
                position[2] + rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2] * w,
            )  # fmt: skip
        visible_faces(lenses, c, half, rotation, position, heights)
        reach = radius * max(lenses[c].focal[0], lenses[c].focal[1]) / (z - radius) + RIM
        left, right = max(0, int(u0 - reach)), min(lenses[c].width - 1, int(u0 + reach) + 1)
        top, bottom = max(0, int(v0 - reach)), min(lenses[c].height - 1, int(v0 + reach) + 1)
        for j in range(top, bottom + 1):
            for i in range(left, right + 1):
                one.extra += labels[c, j, i] > 0
        for face in range(6):
            if heights[face] > 0.0:
                one.extra -= _count_face(
                    labels[c], pixels, face, face_labels[face], left, right, top, bottom, one
                )


@compiled
def explanation_score(seen):  # type: ignore[no-untyped-def]
    """How well a pose explains the label maps: equation (6) of docs/how-it-works.md.

    A hidden pixel counts little, a wrong one much.
    """
    score = 0.0
    for one in seen:
        score += one.agree - 0.4 * one.missing - 1.5 * one.wrong - 0.7 * one.extra
    return score
