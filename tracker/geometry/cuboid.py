"""The cuboid: corners, faces and edges, and which faces a camera sees.

Corner k has its signs in the bits of k: x is positive if bit 0 is set, y if bit 1, z if bit 2.
Faces are ordered +x, -x, +y, -y, +z, -z.
"""

import numpy as np

from tracker.conventions import Array, FloatArray

FACE_NAMES = ("+x", "-x", "+y", "-y", "+z", "-z")

CORNER_SIGNS = np.array([[1.0 if k >> axis & 1 else -1.0 for axis in range(3)] for k in range(8)])
"""(8, 3) signs of the corners; multiplied by half the size, they are the corners in the object's frame."""

KEYPOINT_SIGNS = CORNER_SIGNS[::-1]
"""(8, 3) signs of the corners in the order of the platform's data sets: + if the bit of i is 0."""

FACE_NORMALS = np.array(
    [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=np.float64
)
"""(6, 3) outward normals in the object's frame."""

EDGES = np.array(
    [
        [a, a | 1 << axis, *(2 * other + (~a >> other & 1) for other in range(3) if other != axis)]
        for a in range(8)
        for axis in range(3)
        if not a >> axis & 1
    ],
    dtype=np.int64,
)
"""(12, 4) corner, corner, face, face: the ends of each edge and the two faces that meet at it."""

FACE_CORNERS = np.array(
    [[1, 3, 7, 5], [4, 6, 2, 0], [2, 6, 7, 3], [1, 5, 4, 0], [4, 5, 7, 6], [2, 3, 1, 0]], dtype=np.int64
)
"""(6, 4) corners of each face, counter-clockwise as seen from outside."""


def corners(size: Array) -> Array:
    """Return the corners (8, 3) [m], in the object's frame, of a cuboid with edge lengths `size` (3,) [m]."""
    return CORNER_SIGNS * (np.asarray(size, dtype=np.float64) / 2)


def keypoints(position: Array, rotation: Array, size: Array) -> FloatArray:
    """Return corners (..., 8, 3) [m] of cuboids at positions (..., 3) [m], rotations (..., 3, 3).

    Corner i lies on the + side of x, y, z if bit 0, 1, 2 of i is 0. size: edge lengths (..., 3) [m].
    """
    inside = KEYPOINT_SIGNS * (np.asarray(size, dtype=np.float64)[..., None, :] / 2)
    # The rounding of a matrix product would depend on memory alignment.
    x, y, z = (inside[..., k, None] * rotation[..., None, :, k] for k in range(3))
    return position[..., None, :] + (x + y + z)


def visible_faces(size: Array, object_from_camera_position: Array) -> Array:
    """Return (6,) bool: which faces are visible from a camera at (3,) [m] in the object's frame."""
    position = np.asarray(object_from_camera_position, dtype=np.float64)
    return FACE_NORMALS @ position > np.repeat(np.asarray(size, dtype=np.float64) / 2, 2)
