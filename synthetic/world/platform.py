"""The simulated platform: its contents, and the scenes for a renderer."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from synthetic.closing import Closing
from synthetic.look.appearance import Look
from synthetic.scene import Body, Lighting, Mesh, ObjectState, PlatformScene
from synthetic.world import meshes
from synthetic.world.assets import CONTAINMENT, find_assets
from tracker.conventions import Array, FloatArray
from tracker.geometry import so3
from tracker.objects.model import CuboidModel, load_object

if TYPE_CHECKING:
    from synthetic.world.simulation import World

DICE = "dice"
DICE_COUNT, DIE_SIZE = 25, 0.022
"""Name, number and edge length [m] of the dice."""
PIP_SPREAD, PIP_DIAMETER = 0.0044, 0.0034
"""Distance of the dice's rows of pips from the centre of a face, and the pips' diameter [m], measured in an
image of real dice."""

ARENA_RADIUS = 0.19
"""Radius of the table within the wall [m]."""

_TABLE_RADIUS, _FLOOR_RADIUS, _FLOOR_HEIGHT = 0.1955, 2.0, -0.02
_CROSS_HEIGHT = 0.0002


class Platform(Closing):
    """Robot, table, wall and an object; a context manager. A process may have several.

    PyBullet is imported only for the robot and for physics; scenes without both work without it.

    Args:
        object_name: an object's name or file for `tracker.load_object`, the model itself, or "dice".

    Raises:
        AssetError: the robot's meshes are not available.
        ObjectModelError: the object is unknown or its file malformed.
    """

    def __init__(self, object_name: str | CuboidModel) -> None:
        self.model: CuboidModel | None = None
        if isinstance(object_name, CuboidModel):
            self.model, object_name = object_name, object_name.name
        elif object_name != DICE:
            self.model = load_object(object_name)
        self.object_name = object_name
        self.size: FloatArray = np.full(3, DIE_SIZE) if self.model is None else self.model.size
        """(3,) edge lengths of the object, or of each die [m]."""
        self.count = DICE_COUNT if self.model is None else 1
        """Number of objects."""
        self.assets: Path = find_assets()
        self._object_mesh = (
            meshes.die(DIE_SIZE, PIP_SPREAD, PIP_DIAMETER) if self.model is None else meshes.box(self.size)
        )
        vertices, triangles = meshes.load(self.assets / CONTAINMENT)
        self._wall_mesh = Mesh("wall", vertices, triangles, np.zeros(len(triangles), dtype=np.int64))
        self._table_mesh = meshes.disc(_TABLE_RADIUS)
        self._floor_mesh = meshes.disc(_FLOOR_RADIUS)

    @functools.cached_property
    def world(self) -> World:
        """A world for collision tests only: nothing in it ever moves by physics."""
        return self.new_world()

    @functools.cached_property
    def _robot_meshes(self) -> dict[int, Mesh]:
        from synthetic.world.simulation import robot_meshes

        return robot_meshes(self.world, self.assets)

    def new_world(self, *, robot: bool = True, fast: bool = False) -> World:
        """Return a separate world with this platform's object; its physics depends on nothing else."""
        # Imported here, since it imports PyBullet.
        from synthetic.world.simulation import World

        return World(self.assets, self.size, self.count, robot=robot, fast=fast)

    def close(self) -> None:
        """Free the simulation, if there is one."""
        if "world" in vars(self):
            self.world.close()

    def object_states(self, positions: Array, rotations: Array) -> tuple[ObjectState, ...]:
        """Return the states of objects at positions (N, 3) [m] with rotations (N, 3, 3)."""
        if self.model is not None:
            names = [self.model.name]
        else:
            names = [f"die_{k + 1:02d}" for k in range(DICE_COUNT)]
        triples = zip(names, positions, rotations, strict=False)
        return tuple(ObjectState(name, np.array(p), np.array(r)) for name, p, r in triples)

    def scene(
        self,
        states: Sequence[ObjectState],
        joints: Array | None,
        look: Look,
        lighting: Lighting,
        about: dict[str, Any],
    ) -> PlatformScene:
        """Return everything in view; `joints` (9,) [rad], None: without the robot."""
        bodies = self._surroundings(look)
        if joints is not None:
            self.world.set_joints(joints)
            bodies += [
                Body(
                    name=self.world.links[link],
                    mesh=mesh,
                    world_from_body=self.world.link_pose(link),
                    colors=look.robot,
                    labels=np.zeros(4, dtype=np.uint8),
                    gloss=float(look.gloss[0]),
                    texture=0.02,
                )
                for link, mesh in self._robot_meshes.items()
            ]
        bodies += [self._object_body(index, state, look) for index, state in enumerate(states)]
        position = np.zeros(9) if joints is None else np.array(joints, dtype=np.float64)
        return PlatformScene(tuple(bodies), lighting, tuple(states), position, about)

    def _object_body(self, index: int, state: ObjectState, look: Look) -> Body:
        if self.model is None:
            # A pip counts as part of its die.
            colors, labels = np.stack([look.dice[index], look.pips]), np.full(2, index + 1, dtype=np.uint8)
        else:
            colors, labels = look.faces, self.model.face_labels.astype(np.uint8)
        pose = so3.transform(state.rotation, state.position)
        gloss = float(look.gloss[1])
        faces, rim = self.model is not None, 0.0 if self.model is None else self.model.rim
        return Body(state.name, self._object_mesh, pose, colors, labels, gloss, look.dirt, faces, rim)

    def _surroundings(self, look: Look) -> list[Body]:
        nothing, level = np.zeros(1, dtype=np.uint8), np.eye(3)
        below = so3.transform(level, [0.0, 0.0, _FLOOR_HEIGHT])
        bodies = [
            Body("floor", self._floor_mesh, below, look.floor[None], nothing, 0.0, 0.1),
            Body("table", self._table_mesh, np.eye(4), look.table[None], nothing, float(look.gloss[2]), 0.06),
            Body("wall", self._wall_mesh, np.eye(4), look.wall[None], nothing, float(look.gloss[3]), 0.02),
        ]
        width, length = look.cross_size
        if width > 0:
            for name, size in (("x", [length, width]), ("y", [width, length])):
                # Lower bars for y, so that the two tops do not flicker where they overlap.
                height = _CROSS_HEIGHT * (1.0 if name == "x" else 0.8)
                mesh = meshes.box(np.array([*size, height]), one_group=True)
                pose = so3.transform(level, [0.0, 0.0, height / 2 + 1e-5])
                bodies.append(Body(f"cross_{name}", mesh, pose, look.cross[None], nothing, 0.0, 0.05))
        return bodies
