"""Three simulated fingers that push a cube over the table to a goal, as far as they know where it is."""

from __future__ import annotations

from types import TracebackType

import numpy as np
import pybullet

from synthetic.scene import ObjectState
from synthetic.world.kinematics import BASE_ANGLES, TIP_RADIUS, finger_angles, tips
from synthetic.world.platform import Platform
from tracker.conventions import FloatArray
from tracker.geometry import so3

STEP = 1 / 120
"""Of the control loop [s]."""

_SPEED, _GAIN = 0.10, 3.0  # of the cube: greatest [m/s], and per metre that it is off [1/s]
_KEEP = 4.0  # by how much a tip that is off its place around the cube returns there [1/s]
_GAP = 0.004  # between a tip that does not push and the cube [m]
_LEAD = 0.004  # of where a tip is sent to, before where it is [m]; bounds the force
_FARTHEST = 0.178  # of a tip from the arena's axis [m]
_RUBBER = 1.5  # friction of the tips, which in PyBullet is multiplied by that of the cube
_PRESS = 0.008  # by how much one that pushes is sent into it [m]
_TURNED = 0.2  # of the turn that is wanted, within which they push [rad]
_NEAR = 0.004  # of the goal, where the fingers no longer turn around the cube [m]
_STRAY = 0.6  # of the side from which it is pushed, from which on the fingers turn anew [rad]
_TURN = 1.5  # rate at which they do so [rad/s]

_SIDES = BASE_ANGLES + np.pi / 2
"""(3,) directions in which the fingers are from the cube [rad], each near its own base, but for a turn of up
to 60° that they have in common."""


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
        self._height, self._turn, self._side = height, 0.0, float(np.pi)
        self._aims = self._around(state.position, state.rotation, np.full(3, 0.03))
        self._joints = np.zeros(9)
        self._steer()
        self.world.set_joints(self._joints)

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

        The tips stand around the cube, turned so that one is behind it, and that whole arrangement moves
        towards the goal; those that are behind push. Where the cube is they know from the pose only.

        Args:
            pose: position (3,) [m] and rotation (3, 3) of the cube, as far as known; None: the fingers wait.
            goal: (2,) where its centre shall be [m].
        """
        if pose is not None:
            way = goal - pose[0][:2]
            left = float(np.linalg.norm(way))
            velocity, gaps = np.zeros(2), np.full(3, _GAP)
            if left > _NEAR:
                side = float(np.arctan2(-way[1], -way[0]))
                if abs(np.angle(np.exp(1j * (side - self._side)))) > _STRAY:
                    self._side = side
                behind = _from_behind(self._side)
                self._turn += float(np.clip(behind - self._turn, -_TURN * STEP, _TURN * STEP))
                if abs(behind - self._turn) < _TURNED:
                    velocity = way * min(_GAIN, _SPEED / left)
                    gaps = np.where(self._outward() @ way < 0, -_PRESS, _GAP)
            places = self._around(*pose, gaps)
            self._aims = self._aims + STEP * (velocity + _KEEP * (places - self._aims))
            there = tips(self.world.joint_angles())[:, :2]
            self._aims = there + _shortened(self._aims - there, _LEAD)
            self._aims = _shortened(self._aims, _FARTHEST)
        self._steer()
        self.world.step(round(STEP / self.world.time_step))

    def _outward(self) -> FloatArray:
        """Directions (3, 2) of the fingers from the cube."""
        angles = _SIDES + self._turn
        return np.stack([np.cos(angles), np.sin(angles)], axis=1)

    def _around(self, position: FloatArray, rotation: FloatArray, gaps: FloatArray) -> FloatArray:
        """Places (3, 2) of the tips around the cube, `gaps` away from its faces [m]."""
        outward = self._outward()
        sides = rotation[:2, np.argsort(np.abs(rotation[2]))[:2]]
        sides = sides / np.linalg.norm(sides, axis=0)
        reach = (self._size[0] / 2 + TIP_RADIUS + gaps) / np.abs(outward @ sides).max(axis=1)
        return position[:2] + reach[:, None] * outward

    def _steer(self) -> None:
        for finger, aim in enumerate(self._aims):
            angles = finger_angles(finger, np.array([*aim, self._height]))
            if angles is not None:
                self._joints[3 * finger : 3 * finger + 3] = angles
        self.world.steer(self._joints)


def _from_behind(direction: float) -> float:
    """The turn of the fingers, up to 60°, with which one is on this side of the cube."""
    third = 2 * np.pi / 3
    return float((direction - _SIDES[0] + third / 2) % third - third / 2)


def _shortened(vectors: FloatArray, longest: float) -> FloatArray:
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    result: FloatArray = vectors * np.minimum(1.0, longest / np.maximum(lengths, 1e-12))
    return result
