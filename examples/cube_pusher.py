"""Three simulated fingers that hold a cube between them and push it to a goal, as far as they know where."""

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
"""Of the control loop [s]."""

_SPEED, _GAIN, _CHANGE = 0.1, 8.0, 1.0  # greatest [m/s], per metre that is left [1/s], and its change [m/s²]
_OPEN, _TIGHT = 0.025, -0.006  # from cube to tips' aims: around it, and within it, which presses them on [m]
_CLOSING = 0.08  # rate at which the tips close [m/s]
_AROUND, _LOST = 0.003, 0.025  # from the tips' middle to a cube that is taken, and to one that is lost [m]
_TRUST = 4.0  # rate at which poses correct where a cube that is held is between the tips [1/s]
_BELOW = 0.01  # of the tips, below the cube's middle, so that it does not tilt [m]
_STIFF, _DAMPING = 300.0, 10.0  # a tip's force for being off its aim [N/m], and for its speed [N s/m]
_RUBBER = 1.5  # friction of the tips, which in PyBullet is multiplied by that of the cube
_NUDGE = 1e-6  # of joints, which shows how they move the tips [rad]

_SIDES = BASE_ANGLES + np.pi / 2
"""(3,) directions in which the fingers are from the cube [rad], each near its own base, but for a turn of up
to 15° that they have in common."""


class Pushing:
    """A cube on the table and the fingers around it; a context manager.

    Args:
        platform: with the cube.
        position: (2,) where the cube stands at first [m].
        yaw: how it is turned [rad].
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
        """Let a STEP pass.

        The tips go around the cube, close, and their middle moves so that the cube comes to the goal.

        Args:
            pose: position (3,) [m] and rotation (3, 3) of the cube, as far as known; None: the fingers wait.
            goal: (2,) where its centre shall be [m].
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
        """Where the cube is as seen from the tips' middle, and whether they hold it.

        What is held moves with the tips, whose place is known at once and exactly; poses only correct,
        slowly, where it is between them. So what is wrong with one pose does not move the fingers.
        """
        seen = position[:2] - self._middle
        self._cube = self._cube + (STEP * _TRUST if self._holding else 1.0) * (seen - self._cube)
        self._holding = bool(np.linalg.norm(self._cube) < (_LOST if self._holding else _AROUND))
        if not self._holding:
            self._outward, self._reach = self._arranged(rotation)

    def _arranged(self, rotation: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Directions (3, 2) of the tips from the cube's middle, and how far off they touch it (3, 1) [m].

        One is amid a face, the others are 30° off the middles of two: within their cones of friction.
        """
        sides = rotation[:2, np.argsort(np.abs(rotation[2]))[:2]]
        sides = sides / np.linalg.norm(sides, axis=0)
        turn, sixth = float(np.arctan2(sides[1, 0], sides[0, 0])) - _SIDES[0], np.pi / 6
        angles = _SIDES + (turn + sixth / 2) % sixth - sixth / 2
        outward = np.stack([np.cos(angles), np.sin(angles)], axis=1)
        return outward, (self._size[0] / 2 + TIP_RADIUS) / np.abs(outward @ sides).max(axis=1)[:, None]

    def _aims(self) -> FloatArray:
        """Places (3, 3) to which the tips are drawn [m]."""
        places = self._middle + (self._reach + self._gap) * self._outward
        return np.column_stack([places, np.full(3, self._height)])

    def _release_motors(self) -> None:
        # PyBullet's motors brake until they are switched off.
        robot, joints, client = self.world.robot, self.world.joints, self.world.client
        off = {"controlMode": pybullet.VELOCITY_CONTROL, "forces": [0.0] * len(joints)}
        pybullet.setJointMotorControlArray(robot, joints, **off, physicsClientId=client)

    def _pull(self, aims: FloatArray) -> None:
        """Set torques as if a spring and a damper drew each tip to its aim, and nothing weighed.

        Unlike motors that go to angles, which press as hard as they can and so lift the cube, it is gentle.
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
