"""`tracker live` on a recording: poses told, published as lines, recorded."""

from __future__ import annotations

import json

import numpy as np
import pytest

import tracker
from tests.helpers.command import assert_one_line_error
from tests.helpers.filmed import RIG, shots, write_recording


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """Eight pictures of one scene, each with noise of its own."""
    film, noise = shots("cube_v2", 1, seed=701), np.random.default_rng(1)
    still = film[0]
    many = []
    for _ in range(8):
        images = [image ^ noise.integers(0, 2, image.shape, np.uint8) for image in still.images]
        many.append(type(still)(still.scene, images, still.labels, still.visible_fraction))
    return write_recording(tmp_path_factory.mktemp("live") / "recording", many)


def test_a_recording_is_replayed_told_and_recorded(recording, tmp_path, run_here):
    target = tmp_path / "log.h5"
    result = run_here("live", recording, "--object", "cube_v2", "--record", target)
    assert result.returncode == 0, result.stderr
    assert "sets of images" in result.stdout
    assert "ms in the median" in result.stdout
    with tracker.open_log(target) as log:
        frames = list(log)
        assert log.camera_names == RIG.names
    assert 2 <= len(frames) <= 8
    assert all(frame.recorded_pose is not None for frame in frames[1:])


def test_each_line_of_json_is_a_message(recording, run_here):
    result = run_here("live", recording, "--object", "cube_v2", "--json", "--speed", "0.5")
    assert result.returncode == 0, result.stderr
    messages = [json.loads(line) for line in result.stdout.splitlines()]
    assert len(messages) >= 2
    assert [one["sequence"] for one in messages] == list(range(len(messages)))
    assert messages[-1]["status"] == "tracking"
    assert len(messages[-1]["pose"]["position"]) == 3
    stamps = np.diff([one["timestamp"] for one in messages])
    assert stamps == pytest.approx(0.2 * np.round(stamps / 0.2), abs=1e-3)


def test_poses_are_published_by_several_ways_at_once(recording, tmp_path, run_here):
    lcm = pytest.importorskip("lcm", reason="lcm: no module lcm")
    pytest.importorskip("zmq", reason="live: pyzmq is not installed")
    ways = ("--publish", "tcp://127.0.0.1:*", "--publish", "file://poses.lcm", "--body", "box")
    result = run_here("live", recording, "--object", "cube_v2", "--json", *ways, folder=tmp_path)
    assert result.returncode == 0, result.stderr
    posed = [one for one in map(json.loads, result.stdout.splitlines()) if one["pose"] is not None]
    events = list(lcm.EventLog(str(tmp_path / "poses.lcm")))
    assert len(events) == len(posed) >= 2
    assert {event.channel for event in events} == {"BOX_STATE"}


def test_it_ends_when_it_is_told_to(recording, run_here):
    result = run_here("live", recording, "--object", "cube_v2", "--seconds", "0.05", "--speed", "0.1")
    assert result.returncode == 0, result.stderr
    assert "sets of images  1," in result.stdout


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--rate", "5"], ["--rate", "does nothing"]),
        (["--settings", "x.toml"], ["--settings", "does nothing"]),
        (["--public"], ["--public", "--publish"]),
        (["--publish", "tcp://0.0.0.0:5555"], ["other machines could connect"]),
        (["--publish", "udpm://239.255.76.67:7667?ttl=1"], ["other machines could receive it"]),
        (["--publish", "tcp://127.0.0.1:5555", "--body", "box"], ["--body", "lcm://"]),
        (["--page", "70000"], ["--page", "70000", "65535"]),
        (["--view", "--rrd", "a.rrd"], ["--view", "--rrd"]),
        (["--record", "log.dat"], [".dat", ".h5"]),
        (["--record", "nowhere/log.h5"], ["no folder nowhere"]),
        (["--pattern", "x"], ["--pattern"]),
    ],
)
def test_a_faulty_option_is_named(arguments, words, recording, tmp_path, run_here):
    result = run_here("live", recording, "--object", "cube_v2", *arguments, folder=tmp_path)
    assert_one_line_error(result, *words)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("source", "arguments", "words"),
    [
        ("nowhere", [], ["nowhere", "no such file"]),
        ("webcam:0", [], ["webcam:0", "opencv:0,1,2"]),
        ("opencv:0,1,2", [], ["opencv:0,1,2", "--calibration"]),
        ("simulation", ["--calibration", "x"], ["--calibration", "its own"]),
        ("simulation", ["--speed", "2"], ["--speed", "does nothing"]),
        ("simulation:2", [], ["simulation:2", "there is one"]),
    ],
)
def test_a_faulty_source_is_named(source, arguments, words, tmp_path, run_here):
    assert_one_line_error(
        run_here("live", source, "--object", "cube_v2", *arguments, folder=tmp_path), *words
    )
    assert not list(tmp_path.iterdir())


def test_cameras_that_never_give_an_image_make_the_exit_code_1(recording, tmp_path, run_here):
    absent = ",".join(f"{tmp_path}/absent{number}.mp4" for number in range(3))
    arguments = ("--object", "cube_v2", "--calibration", recording, "--seconds", "0.5")
    result = run_here("live", f"opencv:{absent}", *arguments)
    assert result.returncode == 1
    assert "no camera ever gave an image" in result.stdout


def test_a_check_tells_of_the_cameras_and_nothing_is_wrong_with_them(recording, run_here):
    result = run_here("live", recording, "--object", "cube_v2", "--check", "--speed", "5")
    assert result.returncode == 0, result.stderr
    assert "nothing is wrong with the cameras" in result.stdout
    assert all(name in result.stdout for name in RIG.names)


def test_a_check_of_dark_cameras_exits_with_1(tmp_path, run_here):
    film = shots("cube_v2", 2, seed=702)
    for shot in film:
        shot.images[1] = shot.images[1] // 10
    path = write_recording(tmp_path / "dark", film)
    result = run_here("live", path, "--object", "cube_v2", "--check", "--seconds", "5")
    assert result.returncode == 1
    assert f"{RIG.names[1]}: dark" in result.stdout
    assert f"{RIG.names[0]}: " not in result.stdout


def test_a_check_has_nothing_to_record(recording, tmp_path, run_here):
    arguments = ("--object", "cube_v2", "--check", "--record", tmp_path / "log.h5")
    assert_one_line_error(run_here("live", recording, *arguments), "--check", "tracks nothing")


def test_a_recording_that_ends_is_told_even_to_who_wants_to_hear_of_errors_only(
    recording, tmp_path, run_here, monkeypatch
):
    def refuse(*_):
        raise tracker.errors.LogError("no space is left")

    monkeypatch.setattr("tracker.logs.hdf5_writer.Hdf5LogWriter.append", refuse)
    arguments = ("--record", tmp_path / "log.h5", "--quiet")
    result = run_here("live", recording, "--object", "cube_v2", *arguments)
    assert result.returncode == 1
    assert (result.stdout, result.stderr) == ("", "the recording has ended: no space is left\n")
