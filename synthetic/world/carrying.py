"""Driven acts: finger tips grip an object, lift it, turn it in the air, carry it and set it down.

Physics is off in these acts: the object follows a smooth path, and the fingers follow the object. The first
functions plan contacts of fingers with the object, and collision-free paths to them.
"""

import functools
import itertools
from collections.abc import Iterator, Mapping

import numpy as np

from synthetic.world.acts import (
    SMOOTHSTEP_PEAK,
    Moments,
    Stage,
    joint_path,
    release,
    smooth_steps,
    wait,
    with_finger,
    withdraw,
)
from synthetic.world.fingers import REST, is_clear
from synthetic.world.kinematics import TIP_RADIUS, finger_angles
from synthetic.world.placement import MAX_CLEARANCE, lowest
from synthetic.world.platform import ARENA_RADIUS, Platform
from tracker.conventions import Array, FloatArray
from tracker.geometry import so3
from tracker.geometry.cuboid import FACE_NORMALS

CONTACT_GAP = 0.0008
"""Gap between a tip and the face that it holds [m]. Physics must not find the tip inside the object at
release: Bullet's tip is a millimetre thicker."""

Grip = dict[int, FloatArray]
"""Tips (3,) [m] in the object's frame, by finger."""

_PAUSE_BEFORE_CONTACT = 0.02
_CONTACTS_TRIED = 14
_CHECK_EVERY = 4


def contact_in(platform: Platform, rng: np.random.Generator, face: int) -> FloatArray:
    """Draw a position (3,) [m] of a tip on a face, in the object's frame."""
    size = platform.size
    point: FloatArray = rng.uniform(-0.35, 0.35, 3) * size
    axis = face // 2
    point[axis] = FACE_NORMALS[face, axis] * (size[axis] / 2 + TIP_RADIUS + CONTACT_GAP)
    return point


def held(
    platform: Platform, position: Array, rotation: Array, joints: Array, grip: Mapping[int, Array]
) -> FloatArray | None:
    """Return joint angles (9,) [rad] with the tips at their contacts with the object at this pose.

    None if a contact is out of reach or a finger would collide. Fingers that do not hold stay as in
    `joints`.
    """
    result = np.array(joints, dtype=np.float64)
    for finger, contact in grip.items():
        angles = finger_angles(finger, position + rotation @ contact)
        if angles is None:
            return None
        result[3 * finger : 3 * finger + 3] = angles
    world = platform.world
    world.set_objects(platform.object_states(position[None], rotation[None]))
    world.set_joints(result)
    for finger in range(3):
        others = range(finger)
        if not is_clear(world, finger, result[3 * finger : 3 * finger + 3], others):
            return None
    return result


def random_grip(
    platform: Platform, rng: np.random.Generator, position: Array, rotation: Array, joints: Array
) -> tuple[Grip, FloatArray] | None:
    """Draw a grip of the object at this pose by one to three fingers, and the joint angles (9,) [rad]."""
    current, grip = np.array(joints, dtype=np.float64), Grip()
    faces = [face for face in range(6) if (rotation @ FACE_NORMALS[face])[2] > -0.7]
    for finger in rng.permutation(3).tolist():
        for _ in range(_CONTACTS_TRIED):
            trial = {**grip, finger: contact_in(platform, rng, faces[int(rng.integers(len(faces)))])}
            found = held(platform, position, rotation, current, trial)
            if found is not None:
                grip, current = trial, found
                break
    return (grip, current) if grip else None


def way_to_contact(
    platform: Platform, position: Array, rotation: Array, joints: Array, finger: int, contact: Array
) -> FloatArray | None:
    """Return a collision-free path (M, 9) [rad], one row per PERIOD, of one finger to its contact."""
    axis = int(np.argmax(np.abs(contact) - platform.size / 2))
    outward = np.sign(contact[axis]) * rotation[:, axis]
    tip = position + rotation @ contact
    last = finger_angles(finger, tip)
    before = finger_angles(finger, tip + _PAUSE_BEFORE_CONTACT * outward)
    if last is None or before is None:
        return None
    start = np.array(joints, dtype=np.float64)
    near, end = with_finger(start, finger, before), with_finger(start, finger, last)
    rest = with_finger(start, finger, REST)
    for stops in ([start, near, end], [start, rest, near, end]):
        path = np.vstack([joint_path(a, b) for a, b in itertools.pairwise(stops)])
        if _is_free(platform, position, rotation, path, finger):
            return path
    return None


def _is_free(platform: Platform, position: Array, rotation: Array, path: FloatArray, finger: int) -> bool:
    world = platform.world
    world.set_objects(platform.object_states(position[None], rotation[None]))
    world.set_joints(path[0])
    others = [other for other in range(3) if other != finger]
    # Test the end first: most paths fail there.
    samples = path[::-1][::_CHECK_EVERY]
    return all(
        is_clear(world, finger, joints[3 * finger : 3 * finger + 3], others, gap=0.0002) for joints in samples
    )


SPEEDS = (0.06, 0.28)
"""Range of the largest speed of a carried object [m/s]."""

TURNS = (0.4, 3.3)
"""Range of its largest rate of rotation [rad/s]."""

_REACH = 0.11
_LEGS_TRIED = 24
_GRIPS_TRIED = 6
_CHECKS = 9


def grasp(stage: Stage) -> Moments:
    """Move fingers to the object's faces one after the other; `stage.grip` holds those that arrived."""
    now = stage.moment()
    position, rotation = now.positions[0], now.rotations[0]
    for _ in range(_GRIPS_TRIED):
        found = random_grip(stage.platform, stage.rng, position, rotation, now.joints)
        if found is None:
            continue
        joints, grip = now.joints, Grip()
        for finger, contact in found[0].items():
            path = way_to_contact(stage.platform, position, rotation, joints, finger, contact)
            if path is None:
                continue
            for row in path:
                yield stage.put(position, rotation, row)
            joints, grip[finger] = path[-1], contact
        if grip:
            stage.grip = grip
            return


def leg(stage: Stage, *, lift: bool = False) -> Moments:
    """Move the object along one leg of a path through the air, at rest at both ends; it turns meanwhile.

    `lift`: straight up rather than anywhere. Yields nothing if no leg is possible with this grip.
    """
    rng = stage.rng
    now = stage.moment()
    position, rotation, joints = now.positions[0], now.rotations[0], now.joints
    for attempt in range(_LEGS_TRIED):
        # Bold first, timid later: long legs and large rotations are seldom possible with one grip.
        boldness = 1.0 - attempt / _LEGS_TRIED
        goal, turn = _goal(stage, position, rotation, boldness, lift)
        way = functools.partial(_way, position, rotation, goal, turn)
        speed, rate = rng.uniform(*SPEEDS), rng.uniform(*TURNS)
        distance, angle = float(np.linalg.norm(goal - position)), float(np.linalg.norm(turn))
        checked = way(np.linspace(1.0, 0.0, _CHECKS, endpoint=False))
        if not all(_is_possible(stage, *pose, joints) for pose in checked):
            continue
        seconds = SMOOTHSTEP_PEAK * max(distance / speed, angle / rate, 0.2)
        for place, facing in way(smooth_steps(seconds)):
            found = held(stage.platform, place, facing, joints, stage.grip)
            if found is None:
                # A pose between those that were checked is impossible: end the leg here.
                return
            joints = found
            yield stage.put(place, facing, joints)
        return


def _goal(
    stage: Stage, position: FloatArray, rotation: FloatArray, boldness: float, lift: bool
) -> tuple[FloatArray, FloatArray]:
    """Draw a goal (3,) [m] and a rotation vector (3,) [rad] for the leg."""
    rng = stage.rng
    axis = rng.normal(0.0, 1.0, 3)
    angle = 0.0 if lift and rng.random() < 0.5 else rng.uniform(0.1, 1.0) * np.radians(120) * boldness
    turn: FloatArray = angle * axis / np.linalg.norm(axis)
    clearance = rng.uniform(0.25, 1.0) if lift else rng.uniform(0.05, 1.0)
    height = clearance * MAX_CLEARANCE - lowest(stage.platform.size, so3.exp(turn) @ rotation)
    reach = min(_REACH, ARENA_RADIUS - float(np.linalg.norm(stage.platform.size)) / 2)
    radius, azimuth = reach * np.sqrt(rng.random()), rng.uniform(0, 2 * np.pi)
    away = np.array([radius * np.cos(azimuth), radius * np.sin(azimuth)]) - position[:2]
    share = (0.1 if lift else 1.0) * boldness
    return np.array([*(position[:2] + share * away), height]), turn


def _way(
    position: FloatArray, rotation: FloatArray, goal: FloatArray, turn: FloatArray, shares: FloatArray
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Return positions and rotations at these shares of the leg."""
    return ((position + share * (goal - position), so3.exp(share * turn) @ rotation) for share in shares)


def _is_possible(stage: Stage, position: FloatArray, rotation: FloatArray, joints: FloatArray) -> bool:
    above = position[2] >= -lowest(stage.platform.size, rotation)
    return above and held(stage.platform, position, rotation, joints, stage.grip) is not None


def regrasp(stage: Stage) -> Moments:
    """Move one of several holding fingers to another face, or let an idle one join."""
    now = stage.moment()
    position, rotation = now.positions[0], now.rotations[0]
    fingers = [finger for finger in range(3) if len(stage.grip) > 1 or finger not in stage.grip]
    finger = fingers[int(stage.rng.integers(len(fingers)))]
    kept = {other: contact for other, contact in stage.grip.items() if other != finger}
    for _ in range(_GRIPS_TRIED):
        found = random_grip(stage.platform, stage.rng, position, rotation, now.joints)
        if found is None or finger not in found[0]:
            continue
        contact = found[0][finger]
        path = way_to_contact(stage.platform, position, rotation, now.joints, finger, contact)
        if path is not None:
            stage.grip = kept
            for row in path:
                yield stage.put(position, rotation, row)
            stage.grip = {**kept, finger: contact}
            return


def _pick_up(stage: Stage) -> Moments:
    """Grip the object if it is free, and wait a little if that is not possible."""
    if not stage.grip:
        yield from withdraw(stage)
        yield from grasp(stage)
        if not stage.grip:
            yield from wait(stage, 0.3)


def lift_and_lower(stage: Stage) -> Moments:
    """Grip the object, lift it, turn it a little and let it go."""
    yield from _pick_up(stage)
    if stage.grip:
        yield from leg(stage, lift=True)
        yield from leg(stage)
        yield from release(stage)


def carry(stage: Stage) -> Moments:
    """Carry the object through the air for some legs; grip and lift it first if it is free."""
    lies = not stage.grip
    yield from _pick_up(stage)
    if not stage.grip:
        return
    if lies:
        yield from leg(stage, lift=True)
    for _ in range(int(stage.rng.integers(2, 6))):
        if stage.rng.random() < 0.4:
            yield from regrasp(stage)
        yield from leg(stage)
    # An act must let time pass, even if nothing was possible.
    now = stage.moment()
    yield stage.put(now.positions[0], now.rotations[0], now.joints)
