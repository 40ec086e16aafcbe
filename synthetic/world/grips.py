"""Plans for fingers that hold the object: where they touch it, and ways there that touch nothing else."""

from __future__ import annotations

import itertools
from collections.abc import Mapping

import numpy as np

from synthetic.world.fingers import REST, is_clear
from synthetic.world.kinematics import TIP_RADIUS, finger_angles
from synthetic.world.platform import Platform
from synthetic.world.stage import joint_path, with_finger
from tracker.conventions import Array, FloatArray
from tracker.geometry.cuboid import FACE_NORMALS

CONTACT_GAP = 0.0008
"""Between the tip and the face that it holds [m]; where it lets go, physics
must not find it inside: Bullet takes the tip to be a millimetre thicker."""

Grip = dict[int, FloatArray]
"""Tips (3,) [m] in the object's frame by finger."""

_PAUSE_BEFORE_CONTACT = 0.02
_CONTACTS_TRIED = 14
_CHECK_EVERY = 4


def contact_in(platform: Platform, rng: np.random.Generator, face: int) -> FloatArray:
    """A random place (3,) [m] of a tip on a face, in the object's frame."""
    size = platform.size
    point: FloatArray = rng.uniform(-0.35, 0.35, 3) * size
    axis = face // 2
    point[axis] = FACE_NORMALS[face, axis] * (size[axis] / 2 + TIP_RADIUS + CONTACT_GAP)
    return point


def held(
    platform: Platform, position: Array, rotation: Array, joints: Array, grip: Mapping[int, Array]
) -> FloatArray | None:
    """Joint angles (9,) [rad] with the tips at their contacts with the object at this pose.

    None where one is out of reach, or a finger would touch what it must not. Fingers that do not hold stay
    as in `joints`.
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
    """A grip with one to three fingers of the object at this pose, and the joint angles (9,) [rad]."""
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
    """Joint angles (M, 9) [rad], one row a PERIOD, that bring one finger to its contact, touching nothing."""
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
    # The end first: most ways fail there.
    samples = path[::-1][::_CHECK_EVERY]
    return all(
        is_clear(world, finger, joints[3 * finger : 3 * finger + 3], others, gap=0.0002) for joints in samples
    )
