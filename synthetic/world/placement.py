"""Random poses of objects: on any face, tilted, thrown, in the air; dice thrown or laid out as a goal."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from synthetic.scene import direction
from synthetic.world.platform import ARENA_RADIUS, DICE_COUNT, DIE_SIZE, Platform
from tracker.conventions import Array, FloatArray
from tracker.errors import TrackerError
from tracker.geometry import so3
from tracker.geometry.cuboid import CORNER_SIGNS, FACE_NORMALS, corners

MAX_CLEARANCE = 0.1
"""Largest height above the table of the lowest corner of an object in the air [m]."""

CUBOID_KINDS = {"rest": 0.45, "tilted": 0.07, "thrown": 0.13, "air": 0.35}
DICE_KINDS = {"dice_thrown": 0.5, "dice_goal": 0.5}
"""Kinds of scene and their probabilities."""

_GRID_CELLS = 17

Poses = tuple[FloatArray, FloatArray]
"""Positions (N, 3) [m] and rotations (N, 3, 3)."""

Motion = tuple[FloatArray, FloatArray]
"""Velocity (3,) [m/s] and angular velocity (3,) [rad/s]."""


def place(platform: Platform, rng: np.random.Generator, kind: str) -> tuple[Poses, dict[str, Any]]:
    """Draw poses of all objects in a scene of this kind, and their description for the ground truth."""
    if kind == "dice_thrown":
        return _throw_dice(platform, rng)
    if kind == "dice_goal":
        return _lay_dice(rng)
    if kind == "thrown":
        return _throw(platform, rng)
    about: dict[str, Any] = {}
    clearance = 0.0
    if kind == "air":
        rotation, clearance = random_rotation(rng), rng.uniform(0.0, MAX_CLEARANCE)
        about["clearance"] = clearance
    else:
        face = int(rng.integers(6))
        tilt, axis = (rng.uniform(-np.pi / 4, np.pi / 4), rng.integers(2)) if kind == "tilted" else (0.0, 0)
        rotation = so3.exp([0.0, 0.0, rng.uniform(0, 2 * np.pi)])
        rotation = rotation @ so3.exp(tilt * np.eye(3)[axis]) @ face_up(face)
        about.update(face_up=face, tilt=tilt)
    position = np.array([*random_place(rng, platform.size, rotation), 0.0])
    position[2] = clearance - lowest(platform.size, rotation)
    return (position[None], rotation[None]), about


def random_rotation(rng: np.random.Generator) -> FloatArray:
    """Draw a uniformly distributed rotation (3, 3)."""
    return so3.matrix_from_quaternion(rng.standard_normal(4))


def face_up(face: int) -> FloatArray:
    """Return a rotation (3, 3) that turns a face, by its index in FACE_NAMES, upwards."""
    up, side = FACE_NORMALS[face], FACE_NORMALS[(face + 2) % 6]
    return np.stack([side, np.cross(up, side), up])


def lowest(size: Array, rotation: Array) -> float:
    """Return the height [m] of a cuboid's lowest corner relative to its centre; negative."""
    return float(-np.abs(np.asarray(rotation)[2] * np.asarray(size)).sum() / 2)


def random_place(rng: np.random.Generator, size: Array, rotation: Array) -> FloatArray:
    """Draw x, y (2,) [m] uniformly from the positions with all corners within the arena.

    TrackerError: the object does not fit into the arena in every orientation.
    """
    if (diagonal := float(np.linalg.norm(size))) >= 2 * ARENA_RADIUS:
        valid = f"less than the arena's {2 * ARENA_RADIUS} m"
        raise TrackerError(f"object: found a diagonal of {diagonal:.3g} m, expected {valid}")
    offsets = (corners(size) @ np.asarray(rotation).T)[:, :2]
    while True:
        distance, azimuth = ARENA_RADIUS * np.sqrt(rng.random()), rng.uniform(0, 2 * np.pi)
        center: FloatArray = distance * direction(azimuth)[:2]
        if np.linalg.norm(center + offsets, axis=1).max() < ARENA_RADIUS:
            return center


def lift_onto_table(size: Array, positions: FloatArray, rotations: FloatArray) -> None:
    """Raise, in place, objects that physics left a fraction of a millimetre inside the table."""
    for position, rotation in zip(positions, rotations, strict=True):
        position[2] = max(position[2], -lowest(size, rotation))


def _throw(platform: Platform, rng: np.random.Generator) -> tuple[Poses, dict[str, Any]]:
    """Draw a tumbling object at a random time: in motion, or at rest, perhaps against the wall."""
    rotation = random_rotation(rng)
    start = np.array([*random_place(rng, platform.size, rotation), rng.uniform(0.01, 0.06)])
    start[2] -= lowest(platform.size, rotation)
    azimuth, speed = rng.uniform(0, 2 * np.pi), rng.uniform(0.0, 0.8)
    moment = rng.uniform(0.02, 0.7)
    motion = speed * direction(azimuth), rng.normal(0.0, 3.0, 3)
    return _flown(platform, (start[None], rotation[None]), [motion], moment), {"seconds_after_throw": moment}


def _throw_dice(platform: Platform, rng: np.random.Generator) -> tuple[Poses, dict[str, Any]]:
    """Draw dice that fell onto the table, from a heap (some stay on others) or spread out."""
    spread = rng.uniform(0.02, 0.12)
    centre = rng.uniform(-0.05, 0.05, 2)
    levels = 0.02 + 0.034 * rng.permutation(platform.count) * rng.uniform(0.3, 0.8)
    places = np.clip(centre + rng.normal(0.0, spread, (platform.count, 2)), -0.12, 0.12)
    starts = np.column_stack([places, levels])
    rotations = np.stack([random_rotation(rng) for _ in range(platform.count)])
    seconds = rng.uniform(0.7, 1.2)
    # Thrown downwards: the topmost die would otherwise take half a second to fall.
    motions = [
        (np.array([*rng.normal(0.0, 0.1, 2), -0.8]), rng.normal(0.0, 4.0, 3)) for _ in range(platform.count)
    ]
    poses = _flown(platform, (starts, rotations), motions, seconds)
    return poses, {"spread": spread, "seconds_after_throw": seconds}


def _flown(platform: Platform, start: Poses, motions: Sequence[Motion], seconds: float) -> Poses:
    """Simulate objects for some seconds after they are released in `motions`."""
    with platform.new_world(robot=False, fast=True) as world:
        world.set_objects(platform.object_states(*start))
        for index, motion in enumerate(motions):
            world.set_velocity(index, *motion)
        world.step(round(seconds / world.time_step))
        positions, rotations = world.object_poses()
    lift_onto_table(platform.size, positions, rotations)
    return positions, rotations


def _lay_dice(rng: np.random.Generator) -> tuple[Poses, dict[str, Any]]:
    """Draw dice on cells of the task's grid: scattered or in rows, exact or as a robot would leave them."""
    cells = goal_cells()
    pattern = ["scattered", "block", "rows"][int(rng.integers(3))]
    if pattern == "scattered":
        order = rng.permutation(len(cells))
    elif pattern == "block":
        anchor = cells[int(rng.integers(len(cells)))]
        order = np.argsort(np.abs(cells - anchor).max(axis=1) + 1e-4 * rng.random(len(cells)))
    else:
        # Fill a random line of the grid, then parallel ones: bars with gaps between them.
        axis, step = int(rng.integers(2)), int(rng.integers(2, 4))
        line = np.rint(cells[:, axis] / DIE_SIZE).astype(np.int64)
        first = int(rng.integers(step))
        order = np.lexsort([cells[:, 1 - axis], np.abs(line), (line - first) % step != 0])
    chosen = cells[order[:DICE_COUNT]]
    inexact = rng.uniform(0.0, 1.0) * (rng.random() < 0.7)
    # Turned by 1.1° a die needs 0.21 mm more on each side; shifted by 0.1 mm it stays apart from others.
    yaws = np.radians(np.clip(rng.normal(0.0, 0.6, len(chosen)), -1.1, 1.1)) * inexact
    places = chosen * (1.0 + 0.03 * inexact) + rng.uniform(-0.1, 0.1, chosen.shape) * 1e-3 * inexact
    rotations = np.stack([so3.exp([0.0, 0.0, yaw]) @ face_up(int(rng.integers(6))) for yaw in yaws])
    positions = np.column_stack([places, np.full(len(places), DIE_SIZE / 2)])
    return (positions, rotations), {"pattern": pattern, "inexact": inexact}


def goal_cells() -> FloatArray:
    """Return centres (N, 2) [m] of the cells of the dice task's grid that lie in the arena."""
    line = (np.arange(_GRID_CELLS) - _GRID_CELLS // 2) * DIE_SIZE
    centers = np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1).reshape(-1, 2)
    square = CORNER_SIGNS[:4, :2] * DIE_SIZE / 2
    farthest = np.linalg.norm(centers[:, None] + square, axis=2).max(axis=1)
    result: FloatArray = centers[farthest <= ARENA_RADIUS]
    return result
