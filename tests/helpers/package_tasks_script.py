"""What the platform's simulation package makes of goals and states; runs in an environment that has it.

    python package_tasks_script.py masks OUT.npz CALIBRATION.yml ...
    python package_tasks_script.py tasks OUT.npz

Each writes the cases, drawn from fixed seeds, and what the package says of them.
"""

# The package is no dependency of this project, and neither is what comes along with it.
import sys

import numpy as np
from scipy.spatial.transform import Rotation
from trifinger_simulation.camera import CameraParameters
from trifinger_simulation.tasks import move_cube, move_cube_on_trajectory, move_cuboid, rearrange_dice

SAMPLED, FREE = 100, 30
"""Goals of the dice that the package samples, and others that it calls valid."""

POSES = 1600
"""Random states of each object and level."""

TILTS = (0.0, 1e-9, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 0.02, np.pi - 1e-3, np.pi - 1e-6, np.pi)
"""Angles by which some states are turned away from their goals [rad]."""


def masks(*files: str) -> dict[str, np.ndarray]:
    """`goal` (N, 25, 3) and, for camera k, `mask<k>` (N, H, W): as bits, with `shape<k>`."""
    cameras = []
    for file in files:
        with open(file) as stream:
            cameras.append(CameraParameters.load(stream))
    goals = []
    for seed in range(SAMPLED):
        rearrange_dice.seed(seed)
        goals.append(rearrange_dice.sample_goal())
    rng = np.random.default_rng(1)
    goals += [_free_goal(rng) for _ in range(FREE)]
    drawn = [rearrange_dice.generate_goal_mask(cameras, goal) for goal in goals]
    result = {"goal": np.array(goals)}
    for k in range(len(cameras)):
        stack = np.stack([images[k] for images in drawn])
        assert set(np.unique(stack)) <= {0, 255}
        result[f"mask{k}"], result[f"shape{k}"] = np.packbits(stack > 0), np.array(stack.shape)
    return result


def _free_goal(rng: np.random.Generator) -> np.ndarray:
    """Positions off the grid, half of them above the floor; they may overlap."""
    half = rearrange_dice.DIE_WIDTH / 2
    positions = []
    while len(positions) < rearrange_dice.NUM_DICE:
        x, y = rng.uniform(-rearrange_dice.ARENA_RADIUS, rearrange_dice.ARENA_RADIUS, 2)
        position = (x, y, half + max(0.0, rng.uniform(-0.1, 0.1)))
        if rearrange_dice._is_cell_position_inside_arena(position):
            positions.append(position)
    rearrange_dice.validate_goal(positions)
    return np.array(positions)


def dice() -> dict[str, np.ndarray]:
    """`goal` and `dice` (N, cameras, H, W) masks, sparse to full, and their `cost` (N,)."""
    rng = np.random.default_rng(2)
    shares = rng.choice([0.0, 0.01, 0.3, 0.9, 1.0], (60, 2, 3, 1, 1))
    goal, found = np.moveaxis(np.where(rng.random((60, 2, 3, 45, 60)) < shares, 255, 0), 1, 0).astype(
        np.uint8
    )
    cost = [rearrange_dice.evaluate_state(list(a), list(b)) for a, b in zip(goal, found, strict=True)]
    return {"goal": goal, "dice": found, "cost": np.array(cost)}


def poses() -> dict[str, np.ndarray]:
    """For each object and level: poses (N, 7) of position and quaternion, and their `cost` (N,)."""
    result = {}
    for name, task in (("cube", move_cube), ("cuboid", move_cuboid)):
        for level in (1, 2, 3, 4):
            seed = 10 * level
            task.random = np.random.RandomState(seed)
            rng = np.random.default_rng([seed, len(name)])
            goals = [task.sample_goal(level) for _ in range(POSES)]
            states = [_state(task, goal, k, rng) for k, goal in enumerate(goals)]
            cost = [
                task.evaluate_state(goal, state, level) for goal, state in zip(goals, states, strict=True)
            ]
            for what, listed in (("goal", goals), ("state", states)):
                result[f"{name}{level}_{what}"] = np.array(
                    [np.concatenate([pose.position, pose.orientation]) for pose in listed]
                )
            result[f"{name}{level}_cost"] = np.array(cost)
    return result


def _state(task, goal, index: int, rng: np.random.Generator):
    """Every fourth state is near its goal, or the goal itself, or turned by about half a turn."""
    if index % 4:
        return task.Pose(
            rng.uniform([-0.2, -0.2, 0], [0.2, 0.2, 0.2]), Rotation.random(random_state=index).as_quat()
        )
    tilt = TILTS[index // 4 % len(TILTS)]
    if tilt == 0:
        return goal
    axis = np.eye(3)[index // 4 // len(TILTS) % 3]
    turned = Rotation.from_quat(goal.orientation) * Rotation.from_rotvec(tilt * axis)
    return task.Pose(goal.position + rng.normal(0, 1e-3, 3), turned.as_quat())


def trajectories() -> dict[str, np.ndarray]:
    """`start` (N, K) and `goals` (N, K, 3) of trajectories; `time` (N, M), `position`, `active`, `costs`."""
    rng = np.random.default_rng(4)
    rows = []
    for seed in range(20):
        move_cube_on_trajectory.seed(seed)
        trajectory = move_cube_on_trajectory.sample_goal()
        starts = np.array([start for start, _ in trajectory])
        end = move_cube_on_trajectory.EPISODE_LENGTH
        times = np.concatenate([starts, starts[1:] - 1, [end - 1, end], rng.integers(0, end, 200)])
        states = rng.uniform([-0.2, -0.2, 0], [0.2, 0.2, 0.2], (len(times), 3))
        active = [move_cube_on_trajectory.get_active_goal(trajectory, time) for time in times]
        cost = [
            move_cube_on_trajectory.evaluate_state(trajectory, time, state)
            for time, state in zip(times, states, strict=True)
        ]
        rows.append((starts, np.array([goal for _, goal in trajectory]), times, states, active, cost))
    names = ("start", "goals", "time", "position", "active", "costs")
    return {name: np.array(column) for name, column in zip(names, zip(*rows, strict=True), strict=True)}


if __name__ == "__main__":
    command, out, *files = sys.argv[1:]
    found = masks(*files) if command == "masks" else {**dice(), **poses(), **trajectories()}
    np.savez(out, **found)
