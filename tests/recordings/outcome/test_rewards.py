"""Rewards over a recording, and the time that goals count."""

from __future__ import annotations

import dataclasses
import json

import numpy as np

import tracker
from tests.helpers.recording_stubs import make_job, write_log
from tracker.recordings import run
from tracker.recordings.outcome.rewards import are_of, goal_columns, seconds_since_beginning, totals

FRAMES = 8


def test_rewards_last_until_the_next_and_are_held_where_nothing_was_seen():
    nan = float("nan")
    found = totals(np.array([nan, -1.0, nan, -3.0]), np.array([0.0, 1.0, 3.0, 4.0]))
    assert found == {"reward_total": -(1 + 2 + 1 + 3) * 1e3, "reward_mean": -7 / 5, "error_end": 3.0}
    assert totals(np.array([nan]), np.array([0.0])) == {}


def test_time_counts_from_the_recording_s_first_frame_wherever_poses_begin(tmp_path):
    log = write_log(tmp_path / "log", FRAMES)
    whole = run(make_job(log, tmp_path / "whole.h5")).poses
    part = run(make_job(log, tmp_path / "part.h5", first=3)).poses
    expected = seconds_since_beginning(log, whole)
    assert expected[0] == 0
    np.testing.assert_array_equal(seconds_since_beginning(log, part), expected[3:])


def test_a_goal_of_later_is_that_of_later_frames(tmp_path):
    log = write_log(tmp_path / "log", FRAMES)
    goal = [[0, [0.1, 0.0, 0.05]], [250, [0.0, 0.1, 0.05]], [450, [0.0, 0.0, 0.05]]]
    (tmp_path / "log" / "goal.json").write_text(json.dumps(goal))
    job = make_job(log, tmp_path / "part.h5", first=5)
    poses = run(job).poses
    (tmp_path / "log" / "goal.json").write_text(json.dumps([[0, goal[2][1]]]))
    expected = goal_columns(log, poses, job.recipe.model)["reward_mean"]
    (tmp_path / "log" / "goal.json").write_text(json.dumps(goal))
    assert goal_columns(log, poses, job.recipe.model)["reward_mean"] == expected
    (tmp_path / "log" / "camera_data.dat").unlink()
    assert "camera_data.dat" in goal_columns(log, poses, job.recipe.model)["goal_fault"]


def test_poses_of_another_recording_are_told_from_its_own(tmp_path):
    log = write_log(tmp_path / "log", FRAMES)
    own = run(make_job(log, tmp_path / "own.h5", first=2)).poses
    longer = run(make_job(write_log(tmp_path / "longer", FRAMES + 1), tmp_path / "longer.h5")).poses
    later = dataclasses.replace(own, timestamp=own.timestamp + 1.0)
    with tracker.open_log(log) as opened:
        assert [are_of(opened, poses) for poses in (own, longer, later)] == [True, False, False]
        assert are_of(opened, own[:0])
