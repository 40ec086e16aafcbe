"""The platform in PyBullet: table, wall, robot and objects, without any window."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pybullet

from synthetic.closing import Closing
from synthetic.scene import Mesh, ObjectState, transform
from synthetic.world import meshes
from synthetic.world.assets import CONTAINMENT, URDF
from tracker.conventions import Array, FloatArray
from tracker.geometry import so3

TIME_STEP = 1 / 480
"""Of the physics [s]; PyBullet's usual 1/240 lets a finger that pushes sink in by millimetres."""

DENSITY = 400.0
"""Of objects [kg/m³]: a cube of 65 mm weighs 0.11 kg."""

MOTOR_TORQUE = 1.0
"""Of each joint [N m]: enough to hold the arm, and about 6 N at the tip."""

HULL_MARGIN = 0.001
"""By how much [m] Bullet takes meshes of the robot to be thicker than they are."""

_GRAVITY = 9.81
_PARKED = (0.0, 0.0, -10.0)


class _Client:
    """PyBullet's functions for one of its worlds."""

    def __init__(self, number: int) -> None:
        self._number = number

    def __getattr__(self, name: str) -> Any:
        found = getattr(pybullet, name)
        return functools.partial(found, physicsClientId=self._number) if callable(found) else found


class World(Closing):
    """One PyBullet world; independent of all others and as deterministic as a single one.

    Args:
        assets: folder of the robot's files.
        size: (3,) edge lengths of every object [m].
        count: how many objects there are.
        robot: False: only table, wall and objects, which is 60 ms faster to make.
        fast: with steps twice as long and fewer iterations, good enough for what falls without fingers.
    """

    def __init__(
        self, assets: Path, size: Array, count: int, *, robot: bool = True, fast: bool = False
    ) -> None:
        self.time_step = 2 * TIME_STEP if fast else TIME_STEP
        self._iterations = 15 if fast else 50
        self.client: int = pybullet.connect(pybullet.DIRECT)
        self._bullet: Any = _Client(self.client)
        self._open = True
        try:
            self._fill(assets, np.asarray(size, dtype=np.float64), count, robot)
        except BaseException:
            self.close()
            raise

    def _fill(self, assets: Path, size: FloatArray, count: int, robot: bool) -> None:
        p = self._bullet
        p.setPhysicsEngineParameter(
            fixedTimeStep=self.time_step,
            numSolverIterations=self._iterations,
            deterministicOverlappingPairs=1,
        )
        p.setGravity(0, 0, -_GRAVITY)
        slab = p.createCollisionShape(p.GEOM_BOX, halfExtents=[0.5, 0.5, 0.05])
        self.table: int = p.createMultiBody(0, slab, -1, [0, 0, -0.05])
        wall = p.createCollisionShape(
            p.GEOM_MESH, fileName=str(assets / CONTAINMENT), flags=p.GEOM_FORCE_CONCAVE_TRIMESH
        )
        self.wall: int = p.createMultiBody(0, wall)
        shape = p.createCollisionShape(p.GEOM_BOX, halfExtents=(size / 2).tolist())
        self.mass = mass = DENSITY * float(np.prod(size))
        """Of each object [kg]."""
        self.objects: list[int] = [p.createMultiBody(mass, shape, -1, _PARKED) for _ in range(count)]
        for body in (self.table, self.wall, *self.objects):
            # Rolling friction ends the endless rocking of a box on its edge.
            friction = {"lateralFriction": 0.6, "rollingFriction": 1e-4, "spinningFriction": 1e-3}
            p.changeDynamics(body, -1, restitution=0.2, **friction)
        self.robot: int | None = None
        self.joints: list[int] = []
        self.finger_links: list[list[int]] = []
        if robot:
            self._load_robot(assets)

    def _load_robot(self, assets: Path) -> None:
        p = self._bullet
        # Links may then collide with each other, once let_fingers_collide has chosen them.
        flags = p.URDF_USE_INERTIA_FROM_FILE | p.URDF_USE_SELF_COLLISION
        self.robot = p.loadURDF(str(assets / URDF), useFixedBase=True, flags=flags)
        self.links: dict[int, str] = {}
        for index in range(p.getNumJoints(self.robot)):
            info = p.getJointInfo(self.robot, index)
            self.links[index] = info[12].decode()
            if info[2] == p.JOINT_REVOLUTE:
                self.joints.append(index)
        names = {name: index for index, name in self.links.items()}
        for a in self.links:
            for b in range(a):
                p.setCollisionFilterPair(self.robot, self.robot, a, b, 0)
        kinds = ("upper", "middle", "lower", "tip")
        self.finger_links = [[names[f"finger_{k}_link_{angle}"] for k in kinds] for angle in (0, 120, 240)]

    def close(self) -> None:
        """Frees the world; nothing of it may be used afterwards."""
        if self._open:
            self._open = False
            pybullet.disconnect(physicsClientId=self.client)

    def set_joints(self, joints: Array) -> None:
        """Puts the fingers at joint angles (9,) [rad], at rest."""
        for index, angle in zip(self.joints, np.asarray(joints).tolist(), strict=True):
            self._bullet.resetJointState(self.robot, index, angle, 0.0)

    def set_finger(self, finger: int, angles: Array) -> None:
        """Puts one finger at joint angles (3,) [rad], at rest."""
        for index, angle in zip(self.joints[3 * finger : 3 * finger + 3], angles.tolist(), strict=True):
            self._bullet.resetJointState(self.robot, index, angle, 0.0)

    def let_fingers_collide(self) -> None:
        """Makes fingers obstacles for each other in the physics, which they are not at first."""
        for first in range(3):
            for second in range(first):
                for a in self.finger_links[first]:
                    for b in self.finger_links[second]:
                        self._bullet.setCollisionFilterPair(self.robot, self.robot, a, b, 1)

    def steer(self, joints: Array) -> None:
        """Has the motors go to joint angles (9,) [rad] from the next step on."""
        count = len(self.joints)
        self._bullet.setJointMotorControlArray(
            self.robot,
            self.joints,
            self._bullet.POSITION_CONTROL,
            targetPositions=np.asarray(joints).tolist(),
            forces=[MOTOR_TORQUE] * count,
            positionGains=[0.4] * count,
            velocityGains=[1.0] * count,
        )

    def push(self, index: int, force: Array, torque: Array) -> None:
        """A force [N] and torque [N m] on an object, along world axes, during the next step."""
        p, body = self._bullet, self.objects[index]
        position, _ = p.getBasePositionAndOrientation(body)
        p.applyExternalForce(body, -1, force.tolist(), position, p.WORLD_FRAME)
        p.applyExternalTorque(body, -1, torque.tolist(), p.WORLD_FRAME)

    def joint_angles(self) -> FloatArray:
        """Joint angles (9,) [rad]."""
        states = self._bullet.getJointStates(self.robot, self.joints)
        return np.array([state[0] for state in states])

    def link_pose(self, link: int) -> FloatArray:
        """World from link (4, 4) of a link's frame of the URDF."""
        state = self._bullet.getLinkState(self.robot, link, computeForwardKinematics=True)
        return transform(so3.matrix_from_quaternion(state[5]), state[4])

    def set_objects(self, states: Sequence[ObjectState]) -> None:
        """Puts the objects at rest at their places; those that have none are put out of the way."""
        for index, body in enumerate(self.objects):
            position, quaternion = _PARKED, [0.0, 0.0, 0.0, 1.0]
            if index < len(states):
                position = tuple(states[index].position.tolist())
                quaternion = so3.quaternion_from_matrix(states[index].rotation).tolist()
            self._bullet.resetBasePositionAndOrientation(body, position, quaternion)

    def set_velocity(self, index: int, linear: Array, angular: Array) -> None:
        """Velocity [m/s] and rate of turn [rad/s] of an object, along world axes."""
        self._bullet.resetBaseVelocity(self.objects[index], linear.tolist(), angular.tolist())

    def object_poses(self) -> tuple[FloatArray, FloatArray]:
        """Positions (N, 3) [m] and rotations (N, 3, 3) of all objects."""
        positions, rotations = zip(*map(self.object_pose, range(len(self.objects))), strict=True)
        return np.stack(positions), np.stack(rotations)

    def object_pose(self, index: int) -> tuple[FloatArray, FloatArray]:
        """Position (3,) [m] and rotation (3, 3) of an object."""
        position, quaternion = self._bullet.getBasePositionAndOrientation(self.objects[index])
        return np.array(position), so3.matrix_from_quaternion(quaternion)

    def speed(self, index: int) -> tuple[float, float]:
        """Speed [m/s] and rate of turn [rad/s] of an object."""
        linear, angular = self._bullet.getBaseVelocity(self.objects[index])
        return float(np.linalg.norm(linear)), float(np.linalg.norm(angular))

    def step(self, count: int = 1) -> None:
        """Lets `count` time steps pass."""
        for _ in range(count):
            self._bullet.stepSimulation()

    def near(self, body: int, margin: float, link: int | None = None) -> list[float]:
        """Distances [m] below `margin` of the robot, or of one of its links, from a body."""
        only = {} if link is None else {"linkIndexA": link}
        # Bullet reports no point where the shapes are further apart than asked for.
        points = self._bullet.getClosestPoints(self.robot, body, max(margin - HULL_MARGIN, 0.0), **only)
        found = [point[8] + HULL_MARGIN for point in points]
        return [distance for distance in found if distance < margin]

    def touches_itself(self, first: int, second: int, margin: float) -> bool:
        """Whether two of the robot's links are nearer than `margin` [m]."""
        return bool(
            self._bullet.getClosestPoints(self.robot, self.robot, margin, linkIndexA=first, linkIndexB=second)
        )

    def bounds(self, body: int | None, link: int = -1) -> FloatArray:
        """Least and greatest coordinates (2, 3) [m] of a box around a body, or one of the robot's links."""
        return np.array(self._bullet.getAABB(body, link))


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
