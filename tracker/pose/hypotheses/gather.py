"""The colours that the cameras show around a point."""

from __future__ import annotations

import numpy as np

from tracker.compiled import compiled
from tracker.conventions import Array
from tracker.geometry.lens import project
from tracker.objects.box import Box


def face_mask(box: Box) -> Array:
    """(7,) int32: 1 for the labels that the object's faces have."""
    mask = np.zeros(7, np.int32)
    mask[box.face_labels] = 1
    return mask


@compiled
def gather(lenses, labels, face_mask, used, position, radius, stats):  # type: ignore[no-untyped-def]
    """Stats (C, 7, 3): count, mean column, mean row of each label within `radius` [m] of a position."""
    stats[:] = 0.0
    for c in range(len(used)):
        if not used[c]:
            continue
        u, v, z = project(lenses, c, position[0], position[1], position[2])
        if z < radius:
            continue
        ru, rv = radius * lenses[c].focal[0] / z, radius * lenses[c].focal[1] / z
        width, height = lenses[c].width, lenses[c].height
        for j in range(max(0, int(v - rv)), min(height, int(v + rv) + 2)):
            for i in range(max(0, int(u - ru)), min(width, int(u + ru) + 2)):
                label = labels[c, j, i]
                if face_mask[label] == 0 or ((i - u) / ru) ** 2 + ((j - v) / rv) ** 2 > 1.0:
                    continue
                stats[c, label, 0] += 1.0
                stats[c, label, 1] += i
                stats[c, label, 2] += j
        for label in range(1, 7):
            if stats[c, label, 0] > 0:
                stats[c, label, 1] /= stats[c, label, 0]
                stats[c, label, 2] /= stats[c, label, 0]
