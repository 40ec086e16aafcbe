"""Three simulated fingers that hold a cube between them and push it to a goal, by the poses they know."""

from __future__ import annotations

from types import TracebackType

import numpy as np
import pybullet

from synthetic.scene import ObjectState
from synthetic.world.kinematics import BASE_ANGLES, TIP_RADIUS, finger_angles, tips
from synthetic.world.platform import Platform
from synthetic.world.simulation import MOTOR_TORQUE
from tracker.conventions import FloatArray
from tracker.geometry import so3

STEP = 1 / 120
"""Time step of the control loop [s]."""

_SPEED, _GAIN, _CHANGE = 0.1, 8.0, 1.0  # greatest [m/s], per metre left [1/s], and its greatest change [m/s²]
_OPEN, _TIGHT = 0.025, -0.006  # from the cube to the tips' aims: outside it; inside it, to press on it [m]
_CLOSING = 0.08  # rate at which the tips close [m/s]
_AROUND, _LOST = 0.003, 0.025  # from the tips' midpoint: nearer, a cube is taken; farther, it is lost [m]
_TRUST = 4.0  # rate at which poses correct a held cube's place between the tips [1/s]
_BELOW = 0.01  # how far the tips are below the cube's centre, so that it does not tilt [m]
_STIFF, _DAMPING = 300.0, 10.0  # a tip's force per distance from its aim [N/m], and per speed [N s/m]
_RUBBER = 1.5  # friction of the tips, which PyBullet multiplies by the cube's
_NUDGE = 1e-6  # of a joint, to see how it moves the tips [rad]

_SIDES = BASE_ANGLES + np.pi / 2
"""(3,) directions from the cube to the fingers [rad], each near its own base, up to a common turn of at most
15°."""


class Pushing:
    """A cube on the table and the fingers around it; a context manager.

    Args:
        platform: with the cube.
        position: (2,) where the cube starts [m].
        yaw: of the cube at the start [rad].
    """

    def __init__(self, platform: Platform, position: FloatArray, yaw: float) -> None:
        self._size = platform.size
        height = float(self._size[2] / 2)
        state = ObjectState("cube", np.array([*position, height]), so3.exp(np.array([0.0, 0.0, yaw])))
        self.world = platform.new_world()
        self.world.let_fingers_collide()
        for finger in self.world.finger_links:
            pybullet.changeDynamics(
                self.world.robot, finger[-1], lateralFriction=_RUBBER, physicsClientId=self.world.client
            )
        self.world.set_objects([state])
        self._middle, self._velocity, self._height = state.position[:2], np.zeros(2), height - _BELOW
        self._cube, self._gap, self._holding = np.zeros(2), _OPEN, False
        self._outward, self._reach = self._arranged(state.rotation)
        angles = [finger_angles(finger, tip) for finger, tip in enumerate(self._aims())]
        self.world.set_joints(np.concatenate([one for one in angles if one is not None]))
        self._release_motors()

    def __enter__(self) -> Pushing:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.world.close()

    @property
    def truth(self) -> tuple[FloatArray, FloatArray]:
        """Position (3,) [m] and rotation (3, 3) of the cube."""
        return self.world.object_pose(0)

    def step(self, pose: tuple[FloatArray, FloatArray] | None, goal: FloatArray) -> None:
        """Simulate one STEP.

        The tips surround the cube and close; then their midpoint moves to bring the cube to the goal.

        Args:
            pose: position (3,) [m] and rotation (3, 3) of the cube, or None if unknown: the fingers wait.
            goal: (2,) where its centre should be [m].
        """
        if pose is not None:
            self._take_in(*pose)
            gap = _TIGHT if self._holding else _OPEN
            self._gap += float(np.clip(gap - self._gap, -_CLOSING * STEP, _CLOSING * STEP))
            way = goal - self._middle - self._cube if self._holding else self._cube
            speed = _shortened(_GAIN * way, _SPEED) if abs(self._gap - gap) < 1e-6 else np.zeros(2)
            self._velocity = self._velocity + _shortened(speed - self._velocity, _CHANGE * STEP)
            self._middle = self._middle + STEP * self._velocity
        aims = self._aims()
        for _ in range(round(STEP / self.world.time_step)):
            self._pull(aims)
            self.world.step()

    def _take_in(self, position: FloatArray, rotation: FloatArray) -> None:
        """Update where the cube is relative to the tips' midpoint, and whether they hold it.

        A held cube moves with the tips, whose place is known at once and exactly; poses only correct,
        slowly, its place between them. So an error of a single pose does not move the fingers.
        """
        seen = position[:2] - self._middle
        self._cube = self._cube + (STEP * _TRUST if self._holding else 1.0) * (seen - self._cube)
        self._holding = bool(np.linalg.norm(self._cube) < (_LOST if self._holding else _AROUND))
        if not self._holding:
            self._outward, self._reach = self._arranged(rotation)

    def _arranged(self, rotation: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Directions (3, 2) from the cube's centre to the tips, and distances (3, 1) of contact [m].

        One is normal to a face, the others are 30° off the normals of two: within their friction cones.
        """
        sides = rotation[:2, np.argsort(np.abs(rotation[2]))[:2]]
        sides = sides / np.linalg.norm(sides, axis=0)
        turn, sixth = float(np.arctan2(sides[1, 0], sides[0, 0])) - _SIDES[0], np.pi / 6
        angles = _SIDES + (turn + sixth / 2) % sixth - sixth / 2
        outward = np.stack([np.cos(angles), np.sin(angles)], axis=1)
        return outward, (self._size[0] / 2 + TIP_RADIUS) / np.abs(outward @ sides).max(axis=1)[:, None]

    def _aims(self) -> FloatArray:
        """Places (3, 3) to which the tips are pulled [m]."""
        places = self._middle + (self._reach + self._gap) * self._outward
        return np.column_stack([places, np.full(3, self._height)])

    def _release_motors(self) -> None:
        # PyBullet's motors brake until they are switched off.
        robot, joints, client = self.world.robot, self.world.joints, self.world.client
        off = {"controlMode": pybullet.VELOCITY_CONTROL, "forces": [0.0] * len(joints)}
        pybullet.setJointMotorControlArray(robot, joints, **off, physicsClientId=client)

    def _pull(self, aims: FloatArray) -> None:
        """Set torques as if a spring and a damper pulled each tip to its aim, and nothing had weight.

        This is gentle; position-controlled motors press as hard as they can, and so lift the cube.
        """
        robot, joints, client = self.world.robot, self.world.joints, self.world.client
        states = pybullet.getJointStates(robot, joints, physicsClientId=client)
        angles, rates = (np.array([state[k] for state in states]) for k in (0, 1))
        there = tips(angles)
        change = (tips(angles + _NUDGE * np.eye(9)) - there).reshape(9, 9) / _NUDGE
        force = _STIFF * (aims - there).ravel() - _DAMPING * (rates @ change)
        weight = pybullet.calculateInverseDynamics(
            robot, angles.tolist(), [0.0] * 9, [0.0] * 9, physicsClientId=client
        )
        torques = np.clip(change @ force + weight, -MOTOR_TORQUE, MOTOR_TORQUE)
        pybullet.setJointMotorControlArray(
            robot, joints, pybullet.TORQUE_CONTROL, forces=torques.tolist(), physicsClientId=client
        )


def _shortened(vector: FloatArray, longest: float) -> FloatArray:
    result: FloatArray = vector * min(1.0, longest / max(float(np.linalg.norm(vector)), 1e-12))
    return result
