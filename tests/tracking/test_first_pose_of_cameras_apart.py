from __future__ import annotations

import numpy as np
import pytest

import tracker
from synthetic.camera.rigs import default_cameras
from tests.tracking.test_predict import image_of, new, pose_at
from tracker.geometry import so3


@pytest.mark.parametrize("ages", [(0.0, 0.01, 0.02), (0.02, 0.0, 0.01), (0.01, 0.0, 0.01)])
def test_the_first_pose_of_cameras_apart_in_time_is_as_uncertain_as_it_is_wrong(ages):
    rig = tracker.CameraRig(default_cameras())
    images = [image_of(rig, c, pose_at(0.1 - age), c) for c, age in enumerate(ages)]
    pose = new(rig).update(images, [0.1 - age for age in ages]).object_pose
    place, rotation = pose_at(0.1)
    error = np.concatenate([pose.position - place, so3.log(pose.rotation @ rotation.T)])
    assert error @ np.linalg.solve(pose.covariance, error) < 50
