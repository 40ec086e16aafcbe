"""How well a pose explains the label maps: each pixel near the object against the face that its ray meets."""

from __future__ import annotations

import math

import numpy as np

from tracker.compiled import compiled
from tracker.geometry.lens import project, visible_faces

_LABEL_RIM = 2.5


@compiled
def explain(lenses, labels, used, half, face_labels, rotation, position, seen):  # type: ignore[no-untyped-def]
    """Compare label maps with the pose: numbers of their pixels into seen (C,) of SEEN."""
    heights = np.empty(6)
    origin = np.empty(3)
    radius = math.sqrt(half[0] ** 2 + half[1] ** 2 + half[2] ** 2)
    for c in range(len(used)):
        one = seen[c]
        one.predicted, one.agree, one.missing, one.wrong, one.extra = 0, 0, 0, 0, 0
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
                    one.predicted += 1
                    if label == face_labels[face]:
                        one.agree += 1
                    elif label == 0:
                        one.missing += 1
                    else:
                        one.wrong += 1
                elif label > 0:
                    one.extra += 1


@compiled
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


@compiled
def explanation_score(seen):  # type: ignore[no-untyped-def]
    """How well a pose explains the label maps; a hidden pixel counts little, a wrong one much."""
    score = 0.0
    for one in seen:
        score += one.agree - 0.4 * one.missing - 1.5 * one.wrong - 0.7 * one.extra
    return score
