"""A control loop: images in, predicted poses out; here a recording stands for the cameras."""

import numpy as np

import tracker

DELAY = 0.09  # from the exposure until the fingers act [s]
SURE = 0.9

with tracker.open_log("tracker-demo") as log:
    rig = log.rig or tracker.CameraRig.load("tracker-demo")
    follower = tracker.ObjectTracker(tracker.load_object("cube_v2"), rig)
    for frame in log:  # replace this: the newest image of each camera, or None
        observation = follower.update(frame.images, frame.stamps)
        expected = follower.predict(frame.newest + DELAY)
        if expected is None:
            print(f"stop: {observation.status}")  # not seen for half a second
        elif expected.confidence < SURE:
            print(f"wait: {observation.status}")  # the next images may show more
        else:
            std = 1e3 * np.sqrt(np.diag(expected.covariance)[:3])
            print("act at", expected.position, f"m, known to {std.max():.1f} mm")
