"""The platform in PyBullet, without a window: table, wall, robot and objects."""

import functools
import weakref
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pybullet

from synthetic.closing import Closing
from synthetic.scene import Mesh, ObjectState
from synthetic.world import meshes
from synthetic.world.assets import CONTAINMENT, URDF
from tracker.conventions import Array, FloatArray
from tracker.geometry import so3

TIME_STEP = 1 / 480
"""Time step of the physics [s]; with PyBullet's default 1/240 a pushing finger sinks in by millimetres."""

DENSITY = 400.0
"""Density of objects [kg/m³]: a cube of 65 mm weighs 0.11 kg."""

MOTOR_TORQUE = 1.0
"""Largest torque of each joint [N m]: enough to hold the arm, and about 6 N at the tip."""

HULL_MARGIN = 0.001
"""Thickness that Bullet adds around the robot's meshes [m]."""

_GRAVITY = 9.81
_PARKED = (0.0, 0.0, -10.0)


class _Client:
    """PyBullet's functions, bound to one of its worlds."""

    def __init__(self, number: int) -> None:
        self._number = number

    def __getattr__(self, name: str) -> Any:
        found = getattr(pybullet, name)
        return functools.partial(found, physicsClientId=self._number) if callable(found) else found


class World(Closing):
    """A PyBullet world, independent of all others and deterministic.

    Args:
        assets: folder of the robot's files.
        size: (3,) edge lengths of every object [m].
        count: number of objects.
        robot: False: only table, wall and objects, which saves 60 ms.
        fast: use steps twice as long and fewer iterations, enough for objects that fall without fingers.
    """

    def __init__(
        self, assets: Path, size: Array, count: int, *, robot: bool = True, fast: bool = False
    ) -> None:
        self.time_step = 2 * TIME_STEP if fast else TIME_STEP
        self._iterations = 15 if fast else 50
        self.client: int = pybullet.connect(pybullet.DIRECT)
        # Also frees a world that nobody closes.
        self._free = weakref.finalize(self, pybullet.disconnect, physicsClientId=self.client)
        self._bullet: Any = _Client(self.client)
        self._fill(assets, np.asarray(size, dtype=np.float64), count, robot)

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
        """Mass of each object [kg]."""
        self.objects: list[int] = [p.createMultiBody(mass, shape, -1, _PARKED) for _ in range(count)]
        for body in (self.table, self.wall, *self.objects):
            # Rolling friction stops a box from rocking on its edge forever.
            friction = {"lateralFriction": 0.6, "rollingFriction": 1e-4, "spinningFriction": 1e-3}
            p.changeDynamics(body, -1, restitution=0.2, **friction)
        self.robot: int | None = None
        self.joints: list[int] = []
        self.finger_links: list[list[int]] = []
        if robot:
            self._load_robot(assets)

    def _load_robot(self, assets: Path) -> None:
        p = self._bullet
        # Self-collision is possible only for pairs that let_fingers_collide enables.
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
        """Free the world; it must not be used afterwards."""
        self._free()

    def set_joints(self, joints: Array) -> None:
        """Put the fingers at joint angles (9,) [rad], at rest."""
        for index, angle in zip(self.joints, np.asarray(joints).tolist(), strict=True):
            self._bullet.resetJointState(self.robot, index, angle, 0.0)

    def set_finger(self, finger: int, angles: Array) -> None:
        """Put one finger at joint angles (3,) [rad], at rest."""
        for index, angle in zip(self.joints[3 * finger : 3 * finger + 3], angles.tolist(), strict=True):
            self._bullet.resetJointState(self.robot, index, angle, 0.0)

    def let_fingers_collide(self) -> None:
        """Enable collisions between fingers in the physics; by default they are disabled."""
        for first in range(3):
            for second in range(first):
                for a in self.finger_links[first]:
                    for b in self.finger_links[second]:
                        self._bullet.setCollisionFilterPair(self.robot, self.robot, a, b, 1)

    def steer(self, joints: Array) -> None:
        """Let the motors go to joint angles (9,) [rad] from the next step on."""
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
        """Apply a force [N] and torque [N m], along world axes, to an object during the next step."""
        p, body = self._bullet, self.objects[index]
        position, _ = p.getBasePositionAndOrientation(body)
        p.applyExternalForce(body, -1, force.tolist(), position, p.WORLD_FRAME)
        p.applyExternalTorque(body, -1, torque.tolist(), p.WORLD_FRAME)

    def joint_angles(self) -> FloatArray:
        """Return the joint angles (9,) [rad]."""
        states = self._bullet.getJointStates(self.robot, self.joints)
        return np.array([state[0] for state in states])

    def link_pose(self, link: int) -> FloatArray:
        """Return world_from_link (4, 4) of a link's frame in the URDF."""
        state = self._bullet.getLinkState(self.robot, link, computeForwardKinematics=True)
        return so3.transform(so3.matrix_from_quaternion(state[5]), state[4])

    def set_objects(self, states: Sequence[ObjectState]) -> None:
        """Put the objects at their poses, at rest; objects without a state are put out of the way."""
        for index, body in enumerate(self.objects):
            position, quaternion = _PARKED, [0.0, 0.0, 0.0, 1.0]
            if index < len(states):
                position = tuple(states[index].position.tolist())
                quaternion = so3.quaternion_from_matrix(states[index].rotation).tolist()
            self._bullet.resetBasePositionAndOrientation(body, position, quaternion)

    def set_velocity(self, index: int, linear: Array, angular: Array) -> None:
        """Set the velocity [m/s] and angular velocity [rad/s] of an object, along world axes."""
        self._bullet.resetBaseVelocity(self.objects[index], linear.tolist(), angular.tolist())

    def object_poses(self) -> tuple[FloatArray, FloatArray]:
        """Return positions (N, 3) [m] and rotations (N, 3, 3) of all objects."""
        positions, rotations = zip(*map(self.object_pose, range(len(self.objects))), strict=True)
        return np.stack(positions), np.stack(rotations)

    def object_pose(self, index: int) -> tuple[FloatArray, FloatArray]:
        """Return position (3,) [m] and rotation (3, 3) of an object."""
        position, quaternion = self._bullet.getBasePositionAndOrientation(self.objects[index])
        return np.array(position), so3.matrix_from_quaternion(quaternion)

    def speed(self, index: int) -> tuple[float, float]:
        """Return the speed [m/s] and rate of rotation [rad/s] of an object."""
        linear, angular = self._bullet.getBaseVelocity(self.objects[index])
        return float(np.linalg.norm(linear)), float(np.linalg.norm(angular))

    def step(self, count: int = 1) -> None:
        """Simulate `count` time steps."""
        for _ in range(count):
            self._bullet.stepSimulation()

    def near(self, body: int, margin: float, link: int | None = None) -> list[float]:
        """Return distances [m] below `margin` between the robot, or one of its links, and a body."""
        only = {} if link is None else {"linkIndexA": link}
        # Bullet returns no points for shapes further apart than requested.
        points = self._bullet.getClosestPoints(self.robot, body, max(margin - HULL_MARGIN, 0.0), **only)
        found = [point[8] + HULL_MARGIN for point in points]
        return [distance for distance in found if distance < margin]

    def touches_itself(self, first: int, second: int, margin: float) -> bool:
        """Return whether two of the robot's links are nearer than `margin` [m]."""
        return bool(
            self._bullet.getClosestPoints(self.robot, self.robot, margin, linkIndexA=first, linkIndexB=second)
        )

    def bounds(self, body: int | None, link: int = -1) -> FloatArray:
        """Return smallest and largest coordinates (2, 3) [m] of a body, or of one of the robot's links."""
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
    """Return one mesh for each visible link, in the link's frame."""
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
        # All three fingers have the same links, so their meshes share a key in the renderers' caches.
        key = world.links[link].rsplit("_", 1)[0] if "finger" in world.links[link] else world.links[link]
        result[link] = Mesh(f"robot_{key}", vertices, triangles, groups)
    return result


def _shape(kind: int, size: Sequence[float], file: str, assets: Path) -> list[tuple[FloatArray, Array, int]]:
    """Return vertices, triangles and colour groups of the parts of one visual shape of the URDF."""
    if kind == pybullet.GEOM_CYLINDER:
        return [(*meshes.cylinder(radius=size[1], length=size[0]), DARK)]
    stem = Path(file).stem
    result = [(*meshes.load(assets / "meshes" / "pro" / f"{stem}.stl", np.array(size)), _GROUP_OF_FILE[stem])]
    if stem == "motor_sim":
        # The mesh is a plain disc, while real motors are open and show their copper windings.
        result.append((*meshes.coils(0.0100, 0.0165, _MOTOR_FACE), COPPER))
    return result
