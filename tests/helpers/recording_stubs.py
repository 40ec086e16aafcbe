"""Recordings of tiny noise, and a tracker with memory that is quick; importable by worker processes."""

from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

import tracker
from tests.helpers import make_rig
from tests.helpers.log_writers import make_content, write_native
from tracker.calibration.rig import CameraRig
from tracker.conventions import Image
from tracker.recordings import Job, Recipe


class NoiseTracker:
    """Makes poses of the images' means; its filtered ones depend on all frames since the last reset."""

    def __init__(self, model: Any = None, rig: Any = None, colors: Any = None, *_: Any) -> None:
        self.model, self.rig, self.colors = model, rig, colors
        self._memory: np.ndarray | None = None

    def reset(self) -> None:
        self._memory = None

    def detect(self, images: Sequence[Image | None]) -> SimpleNamespace:
        return SimpleNamespace(object_pose=None, status="poor_fit", cameras=[])

    def update(self, images: Sequence[Image | None], timestamp: float) -> SimpleNamespace:
        position = np.array([np.nan if image is None else image.mean() / 1e4 for image in images])
        self._memory = position if self._memory is None else 0.95 * self._memory + 0.05 * position
        common = {"orientation": np.array([0, 0, 0, 1.0]), "covariance": 1e-6 * np.eye(6), "confidence": 0.9}
        motion = {"velocity": np.zeros(6), "velocity_covariance": np.eye(6)}
        measured = SimpleNamespace(position=position, **common)
        filtered = SimpleNamespace(position=self._memory, **common, **motion)
        found, last = position[0] > 0.0127, "black" if position[2] > 0.0127 else "used"
        return SimpleNamespace(
            object_pose=measured if found else None,
            filtered_object_pose=filtered,
            status="found" if found else "poor_fit",
            cameras=["used", "contradicting" if found else "used", last],
        )


def tiny_rig() -> CameraRig:
    return make_rig(28, 24)


def write_log(folder: Path, frames: int, *, packed: bool = False) -> Path:
    """A native log with its calibration beside it."""
    folder.mkdir(parents=True, exist_ok=True)
    tiny_rig().save(folder)
    return write_native(folder / "camera_data.dat", make_content(frames), packed=packed, poses=1)


def make_job(log: Path, output: Path, **changes: Any) -> Job:
    values: dict[str, Any] = {
        "model": tracker.load_object("cube_v2"),
        "rig": tiny_rig(),
        "colors": tracker.load_colors("cube_v2"),
        "make_tracker": NoiseTracker,
    }
    return Job(log, output, Recipe(**(values | changes)))
