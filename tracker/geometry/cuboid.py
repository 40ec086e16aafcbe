"""The cuboid: corners, faces and edges, and which of them face a camera.

Corner k has the signs of the bits of k: x is positive where bit 0 is set, y bit 1, z bit 2.
Faces are ordered +x, -x, +y, -y, +z, -z.
"""

from __future__ import annotations

import numpy as np

from tracker.conventions import Array

FACE_NAMES = ("+x", "-x", "+y", "-y", "+z", "-z")

CORNER_SIGNS = np.array(
    [[1 if k & 1 else -1, 1 if k & 2 else -1, 1 if k & 4 else -1] for k in range(8)], dtype=np.float64
)
"""(8, 3) signs of the corners; times half the size gives the corners in the object's frame."""

FACE_NORMALS = np.array(
    [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=np.float64
)
"""(6, 3) outward normals in the object's frame."""


def _edges() -> Array:
    rows = []
    for a in range(8):
        for axis in range(3):
            b = a | (1 << axis)
            if b == a:
                continue
            faces = [
                2 * other + (0 if CORNER_SIGNS[a, other] > 0 else 1) for other in range(3) if other != axis
            ]
            rows.append([a, b, *faces])
    return np.array(rows, dtype=np.int64)


EDGES = _edges()
"""(12, 4) corner, corner, face, face: the ends of each edge and the two faces that meet in it."""


def _face_corners() -> Array:
    # Counter-clockwise seen from outside: start with the two in-face axes in right-handed order.
    rows = []
    for face in range(6):
        axis, sign = face // 2, 1 if face % 2 == 0 else -1
        u, v = (axis + 1) % 3, (axis + 2) % 3
        turn = [(-1, -1), (1, -1), (1, 1), (-1, 1)]
        if sign < 0:
            turn = turn[::-1]
        corners = []
        for su, sv in turn:
            signs = np.zeros(3)
            signs[axis], signs[u], signs[v] = sign, su, sv
            corners.append(sum(1 << i for i in range(3) if signs[i] > 0))
        rows.append(corners)
    return np.array(rows, dtype=np.int64)


FACE_CORNERS = _face_corners()
"""(6, 4) corners of each face, counter-clockwise seen from outside."""


def corners(size: Array) -> Array:
    """Corners (8, 3) [m] in the object's frame of a cuboid of edge lengths `size` (3,) [m]."""
    return CORNER_SIGNS * (np.asarray(size, dtype=np.float64) / 2)


def face_centers(size: Array) -> Array:
    """Centres (6, 3) [m] of the faces in the object's frame."""
    return FACE_NORMALS * (np.asarray(size, dtype=np.float64) / 2)


def visible_faces(size: Array, object_from_camera_position: Array) -> Array:
    """Which faces (6,) bool a camera sees whose centre, in the object's frame [m], is given (3,)."""
    position = np.asarray(object_from_camera_position, dtype=np.float64)
    return FACE_NORMALS @ position > np.repeat(np.asarray(size, dtype=np.float64) / 2, 2)
