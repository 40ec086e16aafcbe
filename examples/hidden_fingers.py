"""Tell the tracker which pixels show a finger, from the robot's log: helps if only one camera is left."""

import cv2
import numpy as np

import tracker
from synthetic.silhouettes import FingerMasks
from tracker.logs import paired

ROBOT_LOG, CAMERA = "my_recording/robot_data.csv", "camera60"
CROSS = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))  # neighbouring pixels

with tracker.open_log("my_recording") as log:
    rig = log.rig or tracker.CameraRig.load("tracker-demo")
    finder = tracker.ObjectTracker("cube_v2", rig)
    with FingerMasks(rig) as fingers:
        for frame, robot in paired(log, ROBOT_LOG):
            images = {name: frame.images[k] if name == CAMERA else None for k, name in enumerate(rig.names)}
            hidden = dict(zip(rig.names, fingers(robot.position), strict=True))
            image, mask = images[CAMERA], hidden[CAMERA]
            if image is not None and mask is not None:  # a finger behind the object does not hide it
                shown = (tracker.segment(image, finder.colors) > 0).astype(np.uint8)
                hidden[CAMERA] = mask & (cv2.dilate(shown, CROSS) == 0)
            pose = finder.update(images, frame.stamps, hidden).object_pose
            print(f"{frame.newest:.3f} s", "not found" if pose is None else pose.position)
