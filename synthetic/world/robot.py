"""The robot as its description has it: meshes of its links, with groups of colours."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pybullet

from synthetic.scene import Mesh
from synthetic.world import meshes
from synthetic.world.simulation import World
from tracker.conventions import Array, FloatArray
from tracker.geometry import so3

SHELL, DARK, RUBBER, COPPER = range(4)
"""Colour groups of the robot's meshes: rows of `Look.robot`."""

_GROUP_OF_FILE = {
    "prox-sim": SHELL,
    "int_sim": SHELL,
    "tip_link_sim": SHELL,
    "tip_sim": RUBBER,
    "motor_sim": DARK,
    "center_axis_sim": DARK,
}
_MOTOR_FACE = 0.0162


def robot_meshes(world: World, assets: Path) -> dict[int, Mesh]:
    """One mesh for each link that has something to see, in the link's frame."""
    parts: dict[int, list[tuple[FloatArray, Array, int]]] = {}
    for shape in pybullet.getVisualShapeData(world.robot, physicsClientId=world.client):
        _, link, kind, size, file, position, quaternion, _ = shape[:8]
        rotation = so3.matrix_from_quaternion(quaternion)
        for vertices, triangles, group in _shape(kind, size, file.decode(), assets):
            parts.setdefault(link, []).append((vertices @ rotation.T + position, triangles, group))
    result = {}
    for link, pieces in parts.items():
        vertices, triangles = meshes.concatenate([piece[:2] for piece in pieces])
        groups = np.concatenate([np.full(len(piece[1]), piece[2]) for piece in pieces])
        # All three fingers have the same links: their meshes share a key, and a renderer's upload.
        key = world.links[link].rsplit("_", 1)[0] if "finger" in world.links[link] else world.links[link]
        result[link] = Mesh(f"robot_{key}", vertices, triangles, groups)
    return result


def _shape(kind: int, size: Sequence[float], file: str, assets: Path) -> list[tuple[FloatArray, Array, int]]:
    """Vertices, triangles and colour group of the parts of one visual shape of the URDF."""
    if kind == pybullet.GEOM_CYLINDER:
        return [(*meshes.cylinder(radius=size[1], length=size[0]), DARK)]
    stem = Path(file).stem
    result = [(*meshes.load(assets / "meshes" / "pro" / f"{stem}.stl", np.array(size)), _GROUP_OF_FILE[stem])]
    if stem == "motor_sim":
        # The mesh is a plain disc; the real motors are open and show their copper windings.
        result.append((*meshes.coils(0.0100, 0.0165, _MOTOR_FACE), COPPER))
    return result
