"""Track a cube through a recording; without a calibration in or beside it, load your own."""

import tracker

with tracker.open_log("my_recording") as log:
    follower = tracker.ObjectTracker("cube_v2", log.rig or "tracker-demo")
    for frame in log:
        observation = follower.update(frame.images, frame.stamps)
        pose = observation.filtered_object_pose
        seen = f"{frame.newest:.3f} s  {observation.status}"
        if pose is None:
            print(seen)
        else:
            print(seen, pose.position.round(4), "m", pose.velocity[:3].round(3), "m/s")
