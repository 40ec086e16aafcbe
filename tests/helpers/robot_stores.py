"""Image stores of two robots, and a tracker that knows where the object was; importable by workers."""

import dataclasses
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from tests.helpers.log_writers import make_content, write_store, write_store_by_zarr
from tests.helpers.recording_stubs import NoiseTracker, tiny_rig

GOAL = {"push": 3, "lift": 24}
EPISODES = ((0, 60, 3), (60, 160, 1), (160, 220, 3))
"""First step, first step after it, and robot of each."""

STEPS = EPISODES[-1][1]
LATE = 0.04
"""How much later [s] the stored poses show what the tracker finds."""

SHOWN = np.arange(STEPS) // 5
"""Set of images of each step."""


def position(seconds: np.ndarray) -> np.ndarray:
    """Where the object is (n, 3) [m]."""
    angle = 3 * np.asarray(seconds)
    return np.stack([0.08 * np.cos(angle), 0.08 * np.sin(angle), 0.0325 + 0 * angle], axis=-1)


class KnowingTracker(NoiseTracker):
    """Finds the object where it is, but for one set of images."""

    def update(self, images: Any, timestamp: float) -> SimpleNamespace:
        if abs(timestamp - 1.0) < 1e-6:
            return SimpleNamespace(object_pose=None, filtered_object_pose=None, status="lost", cameras=[])
        pose = {"position": position(timestamp), "orientation": np.array([0, 0, 0, 1.0]), "confidence": 0.9}
        pose |= {"covariance": 1e-6 * np.eye(6), "velocity": np.zeros(6), "velocity_covariance": np.eye(6)}
        one = SimpleNamespace(**pose)
        return SimpleNamespace(object_pose=one, filtered_object_pose=one, status="found", cameras=[])


def observations(task: str) -> np.ndarray:
    """(STEPS, n): stored positions are late, those of robot 3 are 6 mm too high; one is turned."""
    goal = GOAL[task]
    rows = np.zeros((STEPS, 9 + 33 + 49 + 2 * goal), np.float32)
    camera, robot = goal + 9, goal + 9 + 33 + goal
    who = np.concatenate([np.full(last - first, number) for first, last, number in EPISODES])
    rows[:, camera], rows[:, camera + 1] = 0.8, 0.12
    rows[:, camera + 29] = 1
    rows[100:105, camera + 26 : camera + 30] = (1, 0, 0, 0)
    rows[:, camera + 30 : camera + 33] = position(SHOWN / 10 - LATE)
    rows[who == 3, camera + 32] += 0.006
    rows[:, robot + 21 : robot + 30] = np.arange(STEPS)[:, None] + np.arange(9) / 10
    rows[:, robot + 30] = who
    return rows


def write(folder: Path, task: str = "push", *, by_zarr: bool = False, **changes: Any) -> Path:
    """A store of that task, which zarr writes itself if asked to."""
    values = {"shown": 3 * SHOWN, "ends": [last - 1 for _, last, _ in EPISODES]}
    values = {**values, "observations": observations(task), **changes}
    writer = write_store_by_zarr if by_zarr else write_store
    return writer(folder, make_content(STEPS // 5), **values)


def write_robots(folder: Path) -> Path:
    """Calibration files of the robots 1 and 3, whose cameras differ."""
    for number in (1, 3):
        longer = [[1 + number / 100], [1], [1]]
        cameras = [dataclasses.replace(one, matrix=one.matrix * longer) for one in tiny_rig()]
        dataclasses.replace(tiny_rig(), cameras=tuple(cameras)).save(folder)
        for camera in cameras:
            (folder / f"{camera.name}.yml").rename(folder / f"r{number}_{camera.name}.yml")
    return folder
