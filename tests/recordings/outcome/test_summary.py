"""The numbers about a recording."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tests.helpers.pose_logs import random_poses
from tests.helpers.recording_stubs import make_job, write_log
from tracker.pose.result import CameraUse
from tracker.recordings import Tracked, run
from tracker.recordings.outcome.summary import summary, to_look_at

FRAMES = 100


def test_the_summary_counts_what_is_there(tmp_path):
    tracked = run(make_job(write_log(tmp_path, FRAMES), tmp_path / "poses.h5"))
    numbers = summary(tracked)
    measured = float(np.mean(tracked.poses.measured.has_pose))
    assert numbers["frames"] == FRAMES
    assert numbers["measured"] == numbers["statuses"]["found"]["share"] == measured
    assert numbers["statuses"]["poor fit"] == {"share": pytest.approx(1 - measured), "with_pose": 1.0}
    np.testing.assert_allclose(numbers["position_std_median_mm"], 1.0)
    uses = tracked.poses.cameras
    assert numbers["cameras"] == {
        "camera60": {"contradicting": 0.0, "no image": 0.0, "frozen": 0.0, "black": 0.0},
        "camera180": {"contradicting": 1.0, "no image": 0.0, "frozen": 0.0, "black": 0.0},
        "camera300": {
            "contradicting": 0.0,
            "no image": 0.0,
            "frozen": 0.0,
            "black": float(np.mean(uses[:, 2] == "black")),
        },
    }
    assert numbers["recorded"]["share_only_found"] == pytest.approx(1 / FRAMES)


def test_only_cameras_that_need_a_look_are_named(rng):
    poses = random_poses(rng, 1000, share=1)
    uses = np.full((1000, 3), "used", dtype="U20")
    uses[:11, 0], uses[:10, 1] = "no image", "no image"
    uses[:101, 2], uses[101:201, 1] = "contradicting", "contradicting"
    numbers = summary(Tracked(dataclasses.replace(poses, cameras=uses), 1000, None, 0, 0.0))
    assert to_look_at(numbers["cameras"]) == {
        "camera60": {CameraUse.NO_IMAGE: 0.011},
        "camera300": {CameraUse.CONTRADICTING: 0.101},
    }


def test_a_camera_contradicts_only_where_there_is_a_pose(rng):
    poses = dataclasses.replace(random_poses(rng, 10, share=0), cameras=np.full((10, 3), "used"))
    numbers = summary(Tracked(poses, 10, None, 0, 0.0))
    assert numbers["cameras"]["camera60"] == {
        "contradicting": None,
        "no image": 0.0,
        "frozen": 0.0,
        "black": 0.0,
    }
    assert to_look_at(numbers["cameras"]) == {}


def test_where_nothing_is_known_of_the_cameras_nothing_is_said(rng):
    assert summary(Tracked(random_poses(rng, 5, cameras=False), 5, None, 0, 0.0))["cameras"] is None
