"""Moments of `Live` without cameras or a tracker."""

import numpy as np

from tracker.conventions import Image
from tracker.live import ImageSet, Moment
from tracker.pose.result import MotionEstimate, Observation, Status


def estimate(x: float = 0.1) -> MotionEstimate:
    pose = (np.array([x, -0.02, 0.0325]), np.array([0.0, 0.0, 0.6, 0.8]), 1e-6 * np.eye(6), 0.97)
    return MotionEstimate(*pose, velocity=np.arange(6.0), velocity_covariance=np.eye(6))


def moment(
    sequence: int,
    images: tuple[Image | None, ...] = (None,),
    raw: tuple[Image | None, ...] | None = None,
    pose: MotionEstimate | None = None,
) -> Moment:
    stamp = 1000.0 + 0.1 * sequence
    stamps = tuple(stamp - 0.001 * c for c in range(len(images)))
    status = Status.LOST if pose is None else Status.TRACKING
    observation = Observation(pose, pose, status)
    return Moment(sequence, stamp, observation, ImageSet(images, stamps, raw=raw), latency=0.012)
