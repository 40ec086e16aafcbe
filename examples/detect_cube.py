"""Find a cube in the images that `tracker demo` leaves."""

import cv2

import tracker

finder = tracker.ObjectTracker("cube_v2", "tracker-demo")  # the object, and its cameras' calibration
images = [cv2.imread(f"tracker-demo/000000/{name}.jpg") for name in finder.rig.names]

observation = finder.detect(images)
pose = observation.object_pose
if pose is None:
    print("no pose:", observation.status)
else:
    print("position [m]    ", pose.position.round(4))
    print("orientation xyzw", pose.orientation.round(3))
    print("confidence      ", round(pose.confidence, 4))
