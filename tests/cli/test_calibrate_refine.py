"""The command that finds how cameras stand to each other."""

from __future__ import annotations

import pytest

import tracker
from tests.helpers.command import assert_one_line_error
from tests.helpers.filmed import RIG, write_recording
from tests.helpers.moving_cube import carried, knocked, relative_errors

CUBE = ("--object", "cube_v2", "--stills")


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    return write_recording(tmp_path_factory.mktemp("carried") / "recording", list(carried()))


@pytest.fixture(scope="module")
def wrong(tmp_path_factory):
    folder = tmp_path_factory.mktemp("wrong") / "calibration"
    knocked(RIG, seed=4).save(folder)
    return folder


def test_the_calibration_found_is_written_and_told_of(recording, wrong, tmp_path, run_here):
    target = tmp_path / "mended"
    result = run_here(
        "calibrate", "refine", recording, *CUBE, "--calibration", wrong, "--focal", "-o", target
    )
    assert result.returncode == 0, result.stderr
    for words in ("camera60", "against the mean", "in frames that did not teach", "x, y and yaw", "focal"):
        assert words in result.stdout
    rig = tracker.CameraRig.load(target)
    assert (
        abs(relative_errors(rig, RIG)[:, :3]).max()
        < 0.5 * abs(relative_errors(tracker.CameraRig.load(wrong), RIG)[:, :3]).max()
    )


def test_without_a_gain_nothing_is_written(recording, tmp_path, run_here):
    target = tmp_path / "mended"
    result = run_here("calibrate", "refine", recording, *CUBE, "-o", target)
    assert_one_line_error(result, "refused", "frames held out", "px")
    assert not target.exists()


def test_too_few_frames_are_no_option(recording, tmp_path, run_here):
    result = run_here("calibrate", "refine", recording, *CUBE, "--frames", "3", "-o", tmp_path / "new")
    assert_one_line_error(result, "--frames", "18")
