"""Where motion happens: a world with robot and objects that passes from moment to moment."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from types import TracebackType

import numpy as np

from synthetic.scene import ObjectState
from synthetic.world.kinematics import finger_angles, tips
from synthetic.world.placement import lift_onto_table
from synthetic.world.platform import Platform
from tracker.conventions import Array, FloatArray

PERIOD = 1 / 120
"""Between two moments [s]; pictures are taken in between by interpolation."""

JOINT_SPEED = 2.0
"""Greatest rate [rad/s] of a joint that a plan contains."""

_SMOOTHSTEP_PEAK = 1.5


@dataclass(frozen=True, eq=False)
class Moment:
    """Where everything is at one time."""

    positions: FloatArray
    """(N, 3) of the objects [m]."""
    rotations: FloatArray
    """(N, 3, 3)."""
    joints: FloatArray
    """(9,) [rad]."""


Moments = Iterator[Moment]
"""An act: what happens, PERIOD after PERIOD."""


class Stage:
    """Objects and fingers in a world of their own, moved by physics or put where a plan says.

    Args:
        platform: whose object it is; its own world answers the planners' questions.
        rng: source of all randomness of the acts.
        states: where the objects are at first.
        joints: (9,) where the fingers are at first [rad].
    """

    def __init__(
        self, platform: Platform, rng: np.random.Generator, states: Sequence[ObjectState], joints: Array
    ) -> None:
        self.platform, self.rng = platform, rng
        self.grip: dict[int, FloatArray] = {}
        """Tips (3,) [m] in the object's frame of the fingers that hold the object; empty: it is free."""
        self.world = platform.new_world()
        self.world.let_fingers_collide()
        self.world.set_objects(states)
        self.world.set_joints(joints)
        self.target = np.array(joints, dtype=np.float64)
        """(9,) where the motors are to go [rad]."""

    def close(self) -> None:
        """Frees the world."""
        self.world.close()

    def __enter__(self) -> Stage:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def moment(self) -> Moment:
        """How things are now."""
        poses = [self.world.object_pose(index) for index in range(self.platform.count)]
        positions, rotations = np.stack([pose[0] for pose in poses]), np.stack([pose[1] for pose in poses])
        lift_onto_table(self.platform.size, positions, rotations)
        return Moment(positions, rotations, self.world.joint_angles())

    def let_pass(self, target: Array | None = None) -> Moment:
        """Lets physics act for a PERIOD while the motors go to `target` (9,) [rad], or stay where they go."""
        if target is not None:
            self.target = np.array(target, dtype=np.float64)
        self.world.steer(self.target)
        self.world.step(round(PERIOD / self.world.time_step))
        return self.moment()

    def put(self, position: Array, rotation: Array, joints: Array) -> Moment:
        """Puts the one object and all fingers where a plan says, at rest."""
        self.world.set_objects(self.platform.object_states(position[None], rotation[None]))
        self.world.set_velocity(0, np.zeros(3), np.zeros(3))
        self.world.set_joints(joints)
        self.target = np.array(joints, dtype=np.float64)
        return Moment(position[None].copy(), rotation[None].copy(), self.target.copy())

    def follow(self, path: Array) -> Moments:
        """Has the motors follow joint angles (M, 9) [rad], one row a PERIOD, while physics acts."""
        for target in path:
            yield self.let_pass(target)

    def settle(self, longest: float, least: float = 0.0) -> Moments:
        """Lets physics act until the objects are at rest: between `least` and `longest` seconds."""
        for count in range(round(longest / PERIOD)):
            yield self.let_pass()
            speeds = [self.world.speed(index) for index in range(self.platform.count)]
            still = all(linear < 0.005 and angular < 0.05 for linear, angular in speeds)
            if still and count * PERIOD >= least:
                return


def smooth_steps(seconds: float) -> FloatArray:
    """Shares (M,) from just above 0 to 1 of a motion that starts and ends at rest, one a PERIOD."""
    count = max(2, int(np.ceil(seconds / PERIOD)))
    share = np.arange(1, count + 1) / count
    result: FloatArray = share * share * (3 - 2 * share)
    return result


def joint_path(start: Array, goal: Array, speed: float = JOINT_SPEED) -> FloatArray:
    """Joint angles (M, 9) [rad] from `start` to `goal` (9,), no joint faster than `speed` [rad/s]."""
    difference = np.asarray(goal) - np.asarray(start)
    share = smooth_steps(_SMOOTHSTEP_PEAK * float(np.abs(difference).max()) / speed)
    result: FloatArray = start + share[:, None] * difference
    return result


def tip_path(start: Array, finger: int, goal: Array, speed: float) -> FloatArray | None:
    """Joint angles (M, 9) [rad] with one tip on a straight line to `goal` (3,) [m]; None: out of reach.

    `speed` is the tip's greatest [m/s].
    """
    origin = tips(start)[finger]
    distance = float(np.linalg.norm(goal - origin))
    shares = smooth_steps(_SMOOTHSTEP_PEAK * distance / speed)
    result = np.tile(start, (len(shares), 1))
    for row, share in zip(result, shares, strict=True):
        angles = finger_angles(finger, origin + share * (goal - origin))
        if angles is None:
            return None
        row[3 * finger : 3 * finger + 3] = angles
    return result


def with_finger(joints: Array, finger: int, angles: Array) -> FloatArray:
    """Joint angles (9,) with those of one finger (3,) replaced."""
    result = np.array(joints, dtype=np.float64)
    result[3 * finger : 3 * finger + 3] = angles
    return result
