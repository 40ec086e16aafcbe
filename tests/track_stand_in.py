"""`python -m tests.track_stand_in ARGUMENTS...` is `tracker ARGUMENTS...`, also without ObjectTracker.update.

STAND-IN: where ObjectTracker has no `update` yet, it is given one that detects and smooths. As soon as it
has its own, remove this file and run `python -m tracker` where tests run this. Worker processes import
this module as well, so they have it too.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from tracker import cli
from tracker.conventions import Image
from tracker.pipeline import ObjectTracker
from tracker.pose.result import Observation, PoseEstimate


class _Moving(PoseEstimate):
    velocity = np.zeros(6)
    velocity_covariance = np.eye(6)


def _update(tracker: Any, images: Sequence[Image | None], timestamp: float) -> Observation:
    found = tracker.detect(images)
    pose = found.object_pose
    if pose is not None:
        before = getattr(tracker, "_before", pose.position)
        tracker._before = (pose.position + before) / 2
        pose = _Moving(tracker._before, pose.orientation, pose.covariance, pose.confidence)
    return Observation(found.object_pose, pose, found.status)


def _reset(tracker: Any) -> None:
    vars(tracker).pop("_before", None)


if not hasattr(ObjectTracker, "update"):
    ObjectTracker.update = _update
    ObjectTracker.reset = _reset

if __name__ == "__main__":
    cli.main()
