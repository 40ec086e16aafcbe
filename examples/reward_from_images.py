"""Rewards of an episode from its images alone, instead of the simulation's truth."""

import numpy as np

import tracker
from tracker.tasks import move_object

GOAL_POSITION, GOAL_ORIENTATION = (0.05, 0.05, 0.0325), (0.0, 0.0, 0.0, 1.0)  # [m], xyzw

model = tracker.load_object("cube_v2")
rewards = []
with tracker.open_log("my_recording") as log:
    follower = tracker.ObjectTracker(model, log.rig or tracker.CameraRig.load("tracker-demo"))
    for frame in log:
        pose = follower.update(frame.images, frame.stamps).filtered_object_pose
        if pose is None:
            rewards.append(np.nan)  # unknown: an old pose does not replace it
            continue
        state = (pose.position, GOAL_ORIENTATION, pose.orientation)
        rewards.append(float(move_object.reward(4, GOAL_POSITION, *state, model=model)))
unknown = int(np.isnan(rewards).sum())
print(f"reward {np.nansum(rewards):.3f} of {len(rewards)} frames, {unknown} of them unknown")
