"""An observation in numbers, for the footer below the views."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from tracker.conventions import Array
from tracker.pose.result import Observation, PoseEstimate
from tracker.viz.footer import DOUBTFUL, GOOD, Block


def caption(name: str, observation: Observation, title: str) -> Iterable[Block]:
    """Blocks of object, status and the pose's numbers; `title` stands above the object's name."""
    pose, status = observation.object_pose, observation.status.value
    if pose is not None:
        yield Block(([title or "object"], [name], [status]), GOOD)
        yield from _pose_blocks(pose)
        return
    pose = observation.filtered_object_pose
    if pose is not None:
        yield Block(([title or "object"], [name], [f"predicted: {status}"]), DOUBTFUL)
        yield from _pose_blocks(pose)
        return
    yield Block(([title or "object"], [name], [f"no pose: {status}"]), DOUBTFUL)


def _pose_blocks(pose: PoseEstimate) -> Iterable[Block]:
    std = np.sqrt(np.diag(pose.covariance))
    yield Block(
        (
            ["position", "x", "y", "z", ""],
            ["", *_numbers(1e3 * pose.position, 2), "mm"],
            ["std", *_numbers(1e3 * std[:3], 2), "mm"],
        )
    )
    yield Block(
        (
            ["orientation", "x", "y", "z", "w"],
            ["", *_numbers(pose.orientation, 4)],
            ["std", *(f"{value}°" for value in _numbers(np.degrees(std[3:]), 2)), ""],
        )
    )
    yield Block((["confidence"], [f"{pose.confidence:.3f}"], ["within 5 mm, 5°"]))


def _numbers(values: Array, digits: int) -> list[str]:
    return [f"{value:.{digits}f}".replace("-", "−") for value in values]
