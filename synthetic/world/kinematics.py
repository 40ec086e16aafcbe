"""Forward and inverse kinematics of the fingers.

A finger hangs at the height of the hub. Its first joint turns it about the hub's tangent; the other two
bend it in a plane offset from that axis by BEND_OFFSET, so the inverse has a closed form. The tests compare
both with PyBullet's kinematics of the robot's description.
"""

import numpy as np

from tracker.conventions import Array, FloatArray

LOWER_LIMITS = np.array([-0.33, 0.0, -2.7])
"""(3,) smallest joint angles of a finger [rad]."""
UPPER_LIMITS = np.array([1.0, 1.57, 0.0])
"""(3,) largest joint angles of a finger [rad]."""
TIP_RADIUS = 0.01
"""Radius of the rubber sphere at a finger's end [m]; "tip" here means its centre."""
BASE_ANGLES = np.radians([0.0, -120.0, -240.0])
"""(3,) rotation of each finger's base about z [rad]."""

HUB_HEIGHT = 0.29
BEND_OFFSET = 0.01685 + 0.05015 + 0.019
SHOULDER = 0.0505
LINK = 0.16
"""Dimensions of a finger [m]."""


def tips(joints: Array) -> FloatArray:
    """Return the tips (..., 3, 3) [m] at joint angles (..., 9) [rad], one row per finger."""
    q = np.asarray(joints, dtype=np.float64).reshape(*np.shape(joints)[:-1], 3, 3)
    first, second, both = q[..., 0], q[..., 1], q[..., 1] + q[..., 2]
    y = SHOULDER + LINK * (np.sin(second) + np.sin(both))
    z = -LINK * (np.cos(second) + np.cos(both))
    x = np.cos(first) * BEND_OFFSET + np.sin(first) * z
    z = -np.sin(first) * BEND_OFFSET + np.cos(first) * z
    cosine, sine = np.cos(BASE_ANGLES), np.sin(BASE_ANGLES)
    return np.stack([cosine * x - sine * y, sine * x + cosine * y, z + HUB_HEIGHT], axis=-1)


def finger_angles(finger: int, tip: Array) -> FloatArray | None:
    """Return joint angles (3,) [rad] within the limits that put a finger's tip at `tip` (3,) [m], or None."""
    angle = BASE_ANGLES[finger]
    cosine, sine = np.cos(angle), np.sin(angle)
    x = cosine * tip[0] + sine * tip[1]
    y = -sine * tip[0] + cosine * tip[1]
    z = tip[2] - HUB_HEIGHT
    distance = np.hypot(x, z)
    if distance < BEND_OFFSET:
        return None
    # Of the solutions of cos(q0) x - sin(q0) z = BEND_OFFSET, take the one with the finger hanging down.
    first = -np.arccos(BEND_OFFSET / distance) - np.arctan2(z, x)
    first = (first + np.pi) % (2 * np.pi) - np.pi
    down = -(np.sin(first) * x + np.cos(first) * z)
    along = y - SHOULDER
    reach = np.hypot(along, down)
    if not 1e-6 < reach < 2 * LINK:
        return None
    bend = 2 * np.arccos(reach / (2 * LINK))
    result = np.array([first, np.arctan2(along, down) + bend / 2, -bend])
    inside = (result >= LOWER_LIMITS).all() and (result <= UPPER_LIMITS).all()
    return result if inside else None
