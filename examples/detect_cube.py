"""Find a cube in one image of each camera; the images are those that `tracker demo` leaves."""

import cv2
import numpy as np

import tracker

rig = tracker.CameraRig.load("tracker-demo")  # a folder with one calibration file per camera
model = tracker.load_object("cube_v2")
images = [cv2.imread(f"tracker-demo/000000/{name}.jpg") for name in rig.names]

observation = tracker.ObjectTracker(model, rig).detect(images)
pose = observation.object_pose
if pose is None:
    print("no pose:", observation.status)
else:
    std = np.sqrt(np.diag(pose.covariance))
    print("position [mm]   ", 1e3 * pose.position, "+-", 1e3 * std[:3])
    print("orientation xyzw", pose.orientation, "+-", np.degrees(std[3:]), "degrees")
    print("confidence      ", pose.confidence)
