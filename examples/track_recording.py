"""Track a cube through a recording; where the calibration is neither in nor beside it, load your own."""

import tracker

with tracker.open_log("my_recording") as log:
    follower = tracker.ObjectTracker(
        tracker.load_object("cube_v2"), log.rig or tracker.CameraRig.load("tracker-demo")
    )
    for frame in log:
        observation = follower.update(frame.images, frame.stamps)
        pose = observation.filtered_object_pose
        if pose is None:
            print(f"{frame.newest:.3f} s  {observation.status}")
        else:
            print(f"{frame.newest:.3f} s  {observation.status}", pose.position, pose.velocity[:3])
