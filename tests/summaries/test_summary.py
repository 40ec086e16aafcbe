"""What the line about a recording says: numbers, the recording it is of, rewards, the object's way."""

import dataclasses
import json

import numpy as np
import pytest

import tracker
from tests.helpers.pose_logs import random_poses
from tests.helpers.recording_stubs import make_job, write_log
from tracker.errors import LogError
from tracker.pose.result import CameraUse
from tracker.poses.poses import Poses
from tracker.recordings import Tracked, run
from tracker.summaries.rewards import goal_columns, refuse_others, seconds_since_beginning, totals
from tracker.summaries.row import STEP, path_length
from tracker.summaries.summary import summary, to_look_at

FRAMES = 20
NOTHING = {"contradicting": 0.0, "no_image": 0.0, "frozen": 0.0, "black": 0.0}


def test_the_summary_counts_what_is_there(tmp_path):
    tracked = run(make_job(write_log(tmp_path, FRAMES), tmp_path / "poses.h5"))
    numbers = summary(tracked)
    measured = float(np.mean(tracked.poses.measured.has_pose))
    assert numbers["frames"] == FRAMES
    assert numbers["measured"] == numbers["statuses"]["found"]["share"] == measured
    assert numbers["statuses"]["poor_fit"] == {"share": pytest.approx(1 - measured), "with_pose": 1.0}
    np.testing.assert_allclose(numbers["position_std_median_mm"], 1.0)
    uses = tracked.poses.cameras
    assert numbers["cameras"] == {
        "camera60": NOTHING,
        "camera180": {**NOTHING, "contradicting": 1.0},
        "camera300": {**NOTHING, "black": float(np.mean(uses[:, 2] == "black"))},
    }
    assert numbers["recorded"]["share_only_found"] == pytest.approx(1 / FRAMES)


def test_only_cameras_that_need_a_look_are_named(rng):
    poses = random_poses(rng, 1000, share=1)
    uses = np.full((1000, 3), "used", dtype="U20")
    uses[:11, 0], uses[:10, 1] = "no_image", "no_image"
    uses[:101, 2], uses[101:201, 1] = "contradicting", "contradicting"
    numbers = summary(Tracked(dataclasses.replace(poses, cameras=uses), 1000, None, 0, 0.0))
    assert to_look_at(numbers["cameras"]) == {
        "camera60": {CameraUse.NO_IMAGE: 0.011},
        "camera300": {CameraUse.CONTRADICTING: 0.101},
    }


def test_a_camera_contradicts_only_where_there_is_a_pose(rng):
    poses = dataclasses.replace(random_poses(rng, 10, share=0), cameras=np.full((10, 3), "used"))
    numbers = summary(Tracked(poses, 10, None, 0, 0.0))
    assert numbers["cameras"]["camera60"] == {**NOTHING, "contradicting": None}
    assert to_look_at(numbers["cameras"]) == {}
    unknown = random_poses(rng, 5, cameras=False)
    assert summary(Tracked(unknown, 5, None, 0, 0.0))["cameras"] is None


def test_time_counts_from_the_recording_s_first_frame_wherever_poses_begin(tmp_path):
    log = write_log(tmp_path / "log", FRAMES)
    whole = run(make_job(log, tmp_path / "whole.h5")).poses
    part = run(make_job(log, tmp_path / "part.h5", start=3)).poses
    expected = seconds_since_beginning(log, whole)
    assert expected[0] == 0
    np.testing.assert_array_equal(seconds_since_beginning(log, part), expected[3:])


@pytest.mark.parametrize("packed", [False, True])
def test_poses_of_another_recording_are_distinguished_from_its_own(packed, tmp_path):
    log = write_log(tmp_path / "log", FRAMES, packed=packed)
    own = run(make_job(log, tmp_path / "own.h5", start=2)).poses
    with tracker.open_log(log) as opened:

        def refuse(poses: Poses) -> None:
            refuse_others(tmp_path / "poses.h5", poses, log, opened)

        refuse(own)
        refuse(own[:0])
        for other in (
            dataclasses.replace(own, timestamp=own.timestamp + 1.0),
            dataclasses.replace(own, index=own.index + FRAMES),
        ):
            with pytest.raises(LogError, match=r"poses\.h5: found poses of another recording \(camera_data"):
                refuse(other)


def test_rewards_last_until_the_next_and_are_held_where_nothing_was_seen():
    nan = float("nan")
    found = totals(np.array([nan, -1.0, nan, -3.0]), np.array([0.0, 1.0, 3.0, 4.0]))
    assert found == {"reward_total": -(1 + 2 + 1 + 3) * 1e3, "reward_mean": -7 / 5, "error_end": 3.0}
    assert totals(np.array([nan]), np.array([0.0])) == {}


def test_a_goal_of_later_is_that_of_later_frames(tmp_path):
    log = write_log(tmp_path / "log", FRAMES)
    goal = [[0, [0.1, 0.0, 0.05]], [250, [0.0, 0.1, 0.05]], [450, [0.0, 0.0, 0.05]]]
    (tmp_path / "log" / "goal.json").write_text(json.dumps(goal))
    job = make_job(log, tmp_path / "part.h5", start=5)
    poses = run(job).poses
    (tmp_path / "log" / "goal.json").write_text(json.dumps([[0, goal[2][1]]]))
    expected = goal_columns(log, poses, job.recipe.model)["reward_mean"]
    (tmp_path / "log" / "goal.json").write_text(json.dumps(goal))
    assert goal_columns(log, poses, job.recipe.model)["reward_mean"] == expected
    (tmp_path / "log" / "camera_data.dat").unlink()
    assert "camera_data.dat" in goal_columns(log, poses, job.recipe.model)["goal_fault"]


def test_a_goal_that_is_none_leaves_a_well_tracked_recording_without_a_score(tmp_path):
    log = write_log(tmp_path / "log", 2)
    (tmp_path / "log" / "goal.json").write_text("[[0, 5]]")
    job = make_job(log, tmp_path / "poses.h5")
    found = goal_columns(log, run(job).poses, job.recipe.model)
    assert list(found) == ["goal_fault"]
    assert "goal.json: trajectory: entry 0" in found["goal_fault"]


def test_an_object_at_rest_has_no_path(rng):
    still = rng.uniform(-1, 1, (500, 3)) * STEP / 4
    assert path_length(still) == 0
    way = np.linspace(0, 1, 101)[:, None] * [1.0, 0, 0]
    assert path_length(way) == pytest.approx(1.0)
