"""A ray-cast scene as the kernels take it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tracker.conventions import Array

ROOM = np.dtype(
    [
        ("present", "?"),
        ("position", "f8", 3),
        ("rotation", "f8", (3, 3)),
        ("half", "f8", 3),
        ("face_albedos", "f8", (6, 3)),
        ("dirt", "f8"),
        ("seed", "i8"),
        ("light", "f8", 3),
        ("table_radius", "f8"),
        ("table_albedo", "f8", 3),
        ("wall_albedo", "f8", 3),
        ("wall_radii", "f8", 3),
        ("wall_heights", "f8", 3),
        ("cross", "f8", 2),
        ("cross_albedo", "f8", 3),
        ("shadow", "f8"),
    ]
)
"""Object, light, table and wall as the kernels take them; fields as in `Scene` and `Background`."""

CAPSULE = np.dtype([("start", "f8", 3), ("end", "f8", 3), ("radii", "f8", 2), ("albedo", "f8", 3)])
MOTOR = np.dtype([("center", "f8", 3), ("normal", "f8", 3), ("radius", "f8"), ("albedo", "f8", 3)])
VIEW = np.dtype([("eye", "f8", 3), ("rotation", "f8", (3, 3))])
"""A camera: its position [m] and world from camera."""


class World(NamedTuple):
    """A scene as the kernels take it."""

    room: Array
    """(1,) of ROOM."""
    capsules: Array
    """(C,) of CAPSULE."""
    motors: Array
    """(M,) of MOTOR."""
    blotches: Array
    """(N, 4) as in `Background`."""
    lit: Array
    """(K, K) share of the lamp that reaches the table."""
