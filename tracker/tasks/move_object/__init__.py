"""Errors and rewards of the platform's tasks that move an object: to a goal, or along a trajectory of goals.

Positions are of the object's centre in the world [m], orientations quaternions (x, y, z, w) of any length
but 0; plain lists, as in a goal's JSON file, do as well as arrays. Every function works on one state or on
many, such as all of an episode: leading axes are broadcast over.

Goals are finite. A state may hold NaN where the object was not seen; its error and reward are NaN too.
"""

from __future__ import annotations

from tracker.tasks.move_object.corners import keypoints, pose_from_keypoints
from tracker.tasks.move_object.rewards import (
    LEVELS,
    Trajectory,
    active_goal,
    episode_reward,
    long_axis,
    long_axis_error,
    position_error,
    reward,
    rotation_error,
    trajectory_reward,
    weighted_total,
)

__all__ = [
    "LEVELS",
    "Trajectory",
    "active_goal",
    "episode_reward",
    "keypoints",
    "long_axis",
    "long_axis_error",
    "pose_from_keypoints",
    "position_error",
    "reward",
    "rotation_error",
    "trajectory_reward",
    "weighted_total",
]
