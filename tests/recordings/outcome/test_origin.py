"""The recording that poses are of."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import tracker
from tests.helpers.recording_stubs import make_job, write_log
from tracker.errors import LogError
from tracker.poses.poses import Poses
from tracker.recordings import run
from tracker.recordings.outcome.origin import refuse_others, seconds_since_beginning

FRAMES = 8


def test_time_counts_from_the_recording_s_first_frame_wherever_poses_begin(tmp_path):
    log = write_log(tmp_path / "log", FRAMES)
    whole = run(make_job(log, tmp_path / "whole.h5")).poses
    part = run(make_job(log, tmp_path / "part.h5", first=3)).poses
    expected = seconds_since_beginning(log, whole)
    assert expected[0] == 0
    np.testing.assert_array_equal(seconds_since_beginning(log, part), expected[3:])


@pytest.mark.parametrize("packed", [False, True])
def test_poses_of_another_recording_are_told_from_its_own(packed, tmp_path):
    log = write_log(tmp_path / "log", FRAMES, packed=packed)
    own = run(make_job(log, tmp_path / "own.h5", first=2)).poses
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
