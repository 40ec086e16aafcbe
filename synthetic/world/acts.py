"""The stage for motions, and acts simulated by physics: objects are pushed by fingers, tumble, and fall."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from synthetic.closing import Closing
from synthetic.scene import ObjectState, direction
from synthetic.world.fingers import REST, is_clear
from synthetic.world.kinematics import TIP_RADIUS, finger_angles, tips
from synthetic.world.placement import lift_onto_table
from synthetic.world.platform import Platform
from tracker.conventions import Array, FloatArray

PERIOD = 1 / 120
"""Time between two moments [s]; images in between are interpolated."""

JOINT_SPEED = 2.0
"""Largest planned rate of a joint [rad/s]."""

SMOOTHSTEP_PEAK = 1.5


@dataclass(frozen=True, eq=False)
class Moment:
    """Poses of objects and fingers at one time."""

    positions: FloatArray
    """(N, 3) of the objects [m]."""
    rotations: FloatArray
    """(N, 3, 3)."""
    joints: FloatArray
    """(9,) [rad]."""


Moments = Iterator[Moment]
"""An act: its moments, one per PERIOD."""


class Stage(Closing):
    """Objects and fingers in a separate world, moved by physics or placed by a plan.

    Args:
        platform: the platform with the object; the planners use its own world for collision tests.
        rng: source of all randomness of the acts.
        states: initial states of the objects.
        joints: (9,) initial joint angles of the fingers [rad].
    """

    def __init__(
        self, platform: Platform, rng: np.random.Generator, states: Sequence[ObjectState], joints: Array
    ) -> None:
        self.platform, self.rng = platform, rng
        self.grip: dict[int, FloatArray] = {}
        """Tips (3,) [m], in the object's frame, of the fingers that hold the object; empty: it is free."""
        self.world = platform.new_world()
        self.world.let_fingers_collide()
        self.world.set_objects(states)
        self.world.set_joints(joints)
        self.target = np.array(joints, dtype=np.float64)
        """(9,) target angles of the motors [rad]."""

    def close(self) -> None:
        """Free the world."""
        self.world.close()

    def moment(self) -> Moment:
        """Return the current moment."""
        positions, rotations = self.world.object_poses()
        lift_onto_table(self.platform.size, positions, rotations)
        return Moment(positions, rotations, self.world.joint_angles())

    def let_pass(self, target: Array | None = None) -> Moment:
        """Simulate one PERIOD while the motors go to `target` (9,) [rad]; None: to their last target."""
        if target is not None:
            self.target = np.array(target, dtype=np.float64)
        self.world.steer(self.target)
        self.world.step(round(PERIOD / self.world.time_step))
        return self.moment()

    def put(self, position: Array, rotation: Array, joints: Array) -> Moment:
        """Put the one object and all fingers at a planned pose, at rest."""
        self.world.set_objects(self.platform.object_states(position[None], rotation[None]))
        self.world.set_velocity(0, np.zeros(3), np.zeros(3))
        self.world.set_joints(joints)
        self.target = np.array(joints, dtype=np.float64)
        return Moment(position[None].copy(), rotation[None].copy(), self.target.copy())

    def follow(self, path: Array) -> Moments:
        """Simulate while the motors follow joint angles (M, 9) [rad], one row per PERIOD."""
        for target in path:
            yield self.let_pass(target)

    def settle(self, longest: float, least: float = 0.0) -> Moments:
        """Simulate until the objects are at rest: between `least` and `longest` seconds."""
        for count in range(round(longest / PERIOD)):
            yield self.let_pass()
            speeds = [self.world.speed(index) for index in range(self.platform.count)]
            still = all(linear < 0.005 and angular < 0.05 for linear, angular in speeds)
            if still and count * PERIOD >= least:
                return


def smooth_steps(seconds: float) -> FloatArray:
    """Return shares (M,) of a motion, from just above 0 to 1, at rest at both ends, one per PERIOD."""
    count = max(2, int(np.ceil(seconds / PERIOD)))
    share = np.arange(1, count + 1) / count
    return share * share * (3 - 2 * share)


def joint_path(start: Array, goal: Array, speed: float = JOINT_SPEED) -> FloatArray:
    """Return joint angles (M, 9) [rad] from `start` to `goal` (9,), no joint faster than `speed` [rad/s]."""
    difference = np.asarray(goal) - np.asarray(start)
    share = smooth_steps(SMOOTHSTEP_PEAK * float(np.abs(difference).max()) / speed)
    result: FloatArray = start + share[:, None] * difference
    return result


def tip_path(start: Array, finger: int, goal: Array, speed: float) -> FloatArray | None:
    """Return joint angles (M, 9) [rad] that move a tip straight to `goal` (3,) [m]; None: out of reach.

    `speed` is the tip's largest speed [m/s].
    """
    origin = tips(start)[finger]
    distance = float(np.linalg.norm(goal - origin))
    shares = smooth_steps(SMOOTHSTEP_PEAK * distance / speed)
    result = np.tile(start, (len(shares), 1))
    for row, share in zip(result, shares, strict=True):
        angles = finger_angles(finger, origin + share * (goal - origin))
        if angles is None:
            return None
        row[3 * finger : 3 * finger + 3] = angles
    return result


def with_finger(joints: Array, finger: int, angles: Array) -> FloatArray:
    """Return joint angles (9,) with those of one finger (3,) replaced."""
    result = np.array(joints, dtype=np.float64)
    result[3 * finger : 3 * finger + 3] = angles
    return result


PUSH_SPEEDS = (0.06, 0.2)
"""Range of the largest speed of a finger that pushes [m/s]."""

_APPROACH_HEIGHT = 0.105
_RUN_UP = 0.012
_FARTHEST_TIP = 0.18
_ATTEMPTS = 40


def wait(stage: Stage, seconds: float) -> Moments:
    """Let nothing but physics act."""
    for _ in range(max(1, round(seconds / PERIOD))):
        yield stage.let_pass()


def withdraw(stage: Stage) -> Moments:
    """Move all fingers out of the way; whatever they touch on the way moves."""
    goal = np.tile(REST, 3) + stage.rng.uniform(-0.08, 0.08, 9)
    yield from stage.follow(joint_path(stage.world.joint_angles(), goal))
    yield from stage.settle(1.0)


def push(stage: Stage) -> Moments:
    """Lower a finger beside an object and push the object over the table."""
    for _ in range(_ATTEMPTS):
        plan = _plan_push(stage)
        if plan is not None:
            break
    else:
        yield from withdraw(stage)
        return
    finger, above, start, end, speed = plan
    now = stage.world.joint_angles()
    tip = tips(now)[finger]
    up = finger_angles(finger, np.array([tip[0], tip[1], max(tip[2], _APPROACH_HEIGHT)]))
    if up is not None:
        yield from stage.follow(joint_path(now, with_finger(now, finger, up)))
    over = finger_angles(finger, above)
    assert over is not None
    yield from stage.follow(joint_path(stage.target, with_finger(stage.target, finger, over)))
    for goal, fastest in ((start, 0.3), (end, speed), (start + 0.7 * (end - start), 0.2), (above, 0.3)):
        path = tip_path(stage.target, finger, goal, fastest)
        if path is None:
            break
        yield from stage.follow(path)
    yield from stage.settle(0.5)


def _plan_push(stage: Stage) -> tuple[int, FloatArray, FloatArray, FloatArray, float] | None:
    """Return a finger, its tip above, at the start and at the end of a push [m], and its speed [m/s]."""
    rng, platform = stage.rng, stage.platform
    now = stage.moment()
    index = int(rng.integers(platform.count))
    center, rotation = now.positions[index], now.rotations[index]
    # Push towards the middle, within a narrower range of directions the nearer the object is to the wall.
    spread = np.pi * max(0.5, 1.0 - np.hypot(*center[:2]) / 0.25)
    azimuth = np.arctan2(-center[1], -center[0]) + rng.uniform(-spread, spread)
    along = direction(azimuth)
    reach = float(np.abs(along @ rotation * platform.size).sum() / 2)
    height = rng.uniform(TIP_RADIUS + 0.003, max(TIP_RADIUS + 0.006, 1.3 * center[2]))
    base = np.array([center[0], center[1], height])
    base += rng.uniform(-0.25, 0.25) * reach * np.array([-along[1], along[0], 0.0])
    start = base - (reach + TIP_RADIUS + _RUN_UP) * along
    end = base + (rng.uniform(0.02, 0.14) - reach - TIP_RADIUS) * along
    above = np.array([start[0], start[1], _APPROACH_HEIGHT])
    if max(np.hypot(*start[:2]), np.hypot(*(end + reach * along)[:2])) > _FARTHEST_TIP:
        return None
    platform.world.set_objects(platform.object_states(now.positions, now.rotations))
    platform.world.set_joints(now.joints)
    for finger in rng.permutation(3).tolist():
        others = [other for other in range(3) if other != finger]
        places = [above, *(start + share * (end - start) for share in np.linspace(0, 1, 5))]
        angles = [finger_angles(finger, place) for place in places]
        if any(found is None for found in angles):
            continue
        if all(found is not None and is_clear(platform.world, finger, found, others) for found in angles[:2]):
            return finger, above, start, end, rng.uniform(*PUSH_SPEEDS)
    return None


def tumble(stage: Stage) -> Moments:
    """Flick objects: a short push with a torque makes them hop and roll over."""
    rng, world, platform = stage.rng, stage.world, stage.platform
    now = stage.moment()
    chosen = range(platform.count) if platform.count == 1 else rng.choice(platform.count, 4, replace=False)
    seconds = 0.1
    mass = world.mass
    squares = platform.size**2
    moments = mass * (squares.sum() - squares) / 12
    pushes = []
    for index in chosen:
        center = now.positions[index]
        azimuth = np.arctan2(-center[1], -center[0]) + rng.uniform(-1.2, 1.2)
        speed, rate = rng.uniform(0.05, 0.25), rng.uniform(1.0, 4.0)
        along = direction(azimuth)
        velocity = speed * along + [0.0, 0.0, rng.uniform(0.3, 0.6)]
        # It rolls roughly in the direction of flight.
        axis = np.array([-along[1], along[0], 0.0]) + rng.normal(0.0, 0.3, 3)
        force = mass * (velocity / seconds + [0.0, 0.0, 9.81])
        turn = rate / seconds * axis / np.linalg.norm(axis)
        rotation = now.rotations[index]
        pushes.append((int(index), force, rotation @ (moments * (rotation.T @ turn))))
    steps = round(PERIOD / world.time_step)
    for _ in range(round(seconds / PERIOD)):
        for _ in range(steps):
            for index, force, torque in pushes:
                world.push(index, force, torque)
            world.steer(stage.target)
            world.step()
        yield stage.moment()
    yield from stage.settle(1.6, least=0.3)


def release(stage: Stage) -> Moments:
    """Let the fingers release the object, which falls and comes to rest."""
    now = stage.moment()
    outward, stage.grip = stage.grip, {}
    goal = now.joints.copy()
    for finger, contact in outward.items():
        axis = int(np.argmax(np.abs(contact) - stage.platform.size / 2))
        normal = np.sign(contact[axis]) * now.rotations[0][:, axis]
        tip = tips(now.joints)[finger]
        for distance in (0.04, 0.03, 0.02, 0.01):
            away = tip + distance * normal
            angles = finger_angles(finger, np.array([*away[:2], max(away[2], TIP_RADIUS + 0.002)]))
            if angles is not None:
                goal[3 * finger : 3 * finger + 3] = angles
                break
    yield from stage.follow(joint_path(now.joints, goal, speed=4.0))
    yield from stage.settle(1.6, least=0.2)
