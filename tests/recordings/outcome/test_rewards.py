"""Rewards over a recording, and the time that goals count."""

from __future__ import annotations

import json

import numpy as np

from tests.helpers.recording_stubs import make_job, write_log
from tracker.recordings import run
from tracker.recordings.outcome.rewards import goal_columns, totals

FRAMES = 8


def test_rewards_last_until_the_next_and_are_held_where_nothing_was_seen():
    nan = float("nan")
    found = totals(np.array([nan, -1.0, nan, -3.0]), np.array([0.0, 1.0, 3.0, 4.0]))
    assert found == {"reward_total": -(1 + 2 + 1 + 3) * 1e3, "reward_mean": -7 / 5, "error_end": 3.0}
    assert totals(np.array([nan]), np.array([0.0])) == {}


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
