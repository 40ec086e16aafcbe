"""Possible poses of fingers: within their joint limits and without collisions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from synthetic.scene import ObjectState
from synthetic.world.kinematics import LOWER_LIMITS, TIP_RADIUS, UPPER_LIMITS, finger_angles
from synthetic.world.platform import Platform
from tracker.conventions import Array, FloatArray

if TYPE_CHECKING:
    from synthetic.world.simulation import World

GAP = 0.0003
"""Smallest distance between a finger and anything else [m]."""

_ATTEMPTS_NEAR, _ATTEMPTS = 30, 200
_SHARE_OF_RANDOM_ANGLES, _SHARE_OF_RESTING = 0.6, 0.7
_SAFE_RADIUS = 0.19

REST = np.array([0.0, 1.25, -1.55])
"""(3,) joint angles of a finger that is out of the way [rad]."""


def random_fingers(
    platform: Platform, states: Sequence[ObjectState], rng: np.random.Generator, near: float
) -> tuple[FloatArray, list[bool]]:
    """Draw joint angles (9,) [rad] without collisions; also return which tips are near an object's surface.

    Each finger is near with the probability `near`, if it can reach the object.
    """
    world = platform.world
    world.set_objects(states)
    joints, is_near = np.zeros((3, 3)), [False] * 3
    placed: list[int] = []
    for finger in rng.permutation(3).tolist():
        wants = bool(states) and rng.random() < near
        for attempt in range(_ATTEMPTS):
            close = wants and attempt < _ATTEMPTS_NEAR
            tip = tip_near(platform, states, rng) if close else _tip_anywhere(rng)
            angles = _random_angles(rng) if tip is None else finger_angles(finger, tip)
            if angles is not None and is_clear(world, finger, angles, placed):
                joints[finger], is_near[finger] = angles, close
                break
        else:
            joints[finger] = REST
            world.set_finger(finger, REST)
        placed.append(finger)
    return joints.reshape(9), is_near


def tip_near(platform: Platform, states: Sequence[ObjectState], rng: np.random.Generator) -> FloatArray:
    """Draw a position (3,) [m] of a tip that touches an object's surface or is a little above it."""
    state = states[int(rng.integers(len(states)))]
    axis, sign = int(rng.integers(3)), rng.choice([-1.0, 1.0])
    gap = rng.uniform(GAP, 0.001) if rng.random() < 0.5 else rng.exponential(0.008) + GAP
    point = rng.uniform(-0.48, 0.48, 3) * platform.size
    point[axis] = sign * (platform.size[axis] / 2 + TIP_RADIUS + gap)
    return state.position + state.rotation @ point


def is_clear(world: World, finger: int, angles: Array, others: Sequence[int], *, gap: float = GAP) -> bool:
    """Put a finger at joint angles (3,); return whether it keeps `gap` [m] from everything.

    Everything is the table, the wall, the objects and the fingers listed in `others`.
    """
    world.set_finger(finger, angles)
    links = world.finger_links[finger]
    bounds = {link: world.bounds(world.robot, link) for link in links}
    # Bullet's bounds are millimetres too large: they only show where an exact test is needed.
    for link, bound in bounds.items():
        if bound[0, 2] < gap and world.near(world.table, gap, link):
            return False
    for link, bound in bounds.items():
        for body in world.objects:
            if _overlap(bound, world.bounds(body), gap) and world.near(body, gap, link):
                return False
    foreign = {link for other in others for link in world.finger_links[other]}
    for link, bound in bounds.items():
        farthest = np.hypot(*np.abs(bound[:, :2]).max(axis=0))
        if farthest > _SAFE_RADIUS and world.near(world.wall, gap, link):
            return False
    for link, bound in bounds.items():
        for other in foreign:
            apart = not _overlap(bound, world.bounds(world.robot, other), gap)
            if not apart and world.touches_itself(link, other, gap):
                return False
    return not (
        world.touches_itself(links[0], links[2], 0.0) or world.touches_itself(links[0], links[3], 0.0)
    )


def _overlap(first: Array, second: Array, gap: float) -> bool:
    return bool((first[0] <= second[1] + gap).all() and (second[0] <= first[1] + gap).all())


def _tip_anywhere(rng: np.random.Generator) -> FloatArray | None:
    if rng.random() < _SHARE_OF_RANDOM_ANGLES:
        return None
    radius, azimuth = 0.19 * np.sqrt(rng.random()), rng.uniform(0, 2 * np.pi)
    height = TIP_RADIUS + (0.0005 if rng.random() < 0.3 else rng.uniform(0.0005, 0.15))
    return np.array([radius * np.cos(azimuth), radius * np.sin(azimuth), height])


def _random_angles(rng: np.random.Generator) -> FloatArray:
    if rng.random() < _SHARE_OF_RESTING:
        return np.clip(REST + rng.normal(0.0, 0.2, 3), LOWER_LIMITS, UPPER_LIMITS)
    return rng.uniform(LOWER_LIMITS, UPPER_LIMITS)
