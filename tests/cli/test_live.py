import fcntl
import functools
import json
import shutil
import signal
import struct
import time
from dataclasses import replace
from types import SimpleNamespace
from unittest.mock import Mock

import click
import cv2
import numpy as np
import pytest

import tracker
from tests.cli.test_cli import CODES, ask_to_end
from tests.helpers.command import assert_one_line_error, begin, well
from tests.helpers.log_writers import CAMERAS, write_picture
from tests.helpers.moments import estimate, moment
from tests.helpers.reading import frames_of
from tracker.cli.demo import DATA
from tracker.cli.live_outputs import Lookout, Statistics


@pytest.fixture
def live(run_here):
    return functools.partial(run_here, "live", "--object", "cube_v2")


def test_a_recording_is_replayed_printed_and_recorded(tmp_path, live):
    target = tmp_path / "log.h5"
    result = well(live(DATA, "--speed", 2, "--record", target))
    assert "sets of images" in result.stdout
    assert "latency         median" in result.stdout
    with tracker.open_log(target) as log:
        frames = list(log)
        assert log.camera_names == CAMERAS
    assert 2 <= len(frames) <= 20
    assert all(frame.recorded_pose is not None for frame in frames[1:])


def test_each_line_of_json_is_a_message(live):
    result = well(live(DATA, "--json", "--speed", 2))
    messages = [json.loads(line) for line in result.stdout.splitlines()]
    assert len(messages) >= 2
    assert [one["sequence"] for one in messages] == list(range(len(messages)))
    assert messages[-1]["status"] == "tracking"
    assert len(messages[-1]["pose"]["position"]) == 3
    stamps = np.diff([one["timestamp"] for one in messages])
    assert stamps == pytest.approx(0.05 * np.round(stamps / 0.05), abs=1e-3)


@pytest.mark.process
def test_who_does_not_read_the_json_holds_up_nothing(tmp_path):
    with begin("live", DATA, "--object", "cube_v2", "--json", "--record", tmp_path / "log.h5") as process:
        fcntl.fcntl(process.stdout, fcntl.F_SETPIPE_SZ, 4096)  # room for two messages
        assert process.wait(60) == 0
    assert len(frames_of(tmp_path / "log.h5")) > 2


def test_messages_that_cannot_be_printed_end_the_command(live, monkeypatch):
    def print_what_is_no_message(text, *_, err=False, echo=click.echo, **more):
        if not err:
            raise OSError(28, "No space left on device")
        echo(text, err=err, **more)

    monkeypatch.setattr("click.echo", print_what_is_no_message)
    assert_one_line_error(live(DATA, "--json"), "output: No space left on device")


def test_poses_are_published_by_several_ways_at_once(tmp_path, live):
    lcm = pytest.importorskip("lcm", reason="lcm: no module lcm")
    pytest.importorskip("zmq", reason="live: pyzmq is not installed")
    ways = ("--publish", "tcp://127.0.0.1:*", "--publish", "file://poses.lcm", "--body", "box")
    result = well(live(DATA, "--json", *ways, folder=tmp_path))
    posed = [one for one in map(json.loads, result.stdout.splitlines()) if one["pose"] is not None]
    events = list(lcm.EventLog(str(tmp_path / "poses.lcm")))
    assert len(events) == len(posed) >= 2
    assert {event.channel for event in events} == {"BOX_STATE"}


def test_it_ends_on_request(live):
    result = well(live(DATA, "--seconds", "0.5", "--speed", "0.02"))
    assert "sets of images  1," in result.stdout


@pytest.mark.parametrize("number", CODES)
def test_a_signal_ends_it_with_its_files_whole_and_is_reported_by_the_exit_code(
    number, tmp_path, live, monkeypatch
):
    def ask(_: float) -> None:
        time.sleep(0.3)
        ask_to_end(number)

    clock = SimpleNamespace(monotonic=time.monotonic, sleep=ask)
    monkeypatch.setattr("tracker.cli.live.time", clock)
    result = live(DATA, "--speed", "0.1", "--record", tmp_path / "log.h5")
    assert result.returncode == CODES[number]
    assert ("sets of images" in result.stdout) == (number == signal.SIGINT)
    with tracker.open_log(tmp_path / "log.h5") as log:
        assert log.fault is None


def test_cameras_that_never_give_an_image_are_an_error(tmp_path, live, monkeypatch):
    absent = ",".join(f"{tmp_path}/absent{number}.mp4" for number in range(3))
    arguments = (f"opencv:{absent}", "--calibration", DATA)
    # However long the machine takes to begin.
    monkeypatch.setattr("tracker.live.cameras.OPENING", 60.0)
    result = live(*arguments, "--seconds", "0.1")
    assert result.returncode == 2
    assert "no camera ever gave an image" in result.stdout
    assert "no camera ever gave an image" in live(*arguments, "--seconds", "0.1", "-q").stderr
    checked = live(*arguments, "--check", "--seconds", "1")
    assert (checked.returncode, "images are missing" in checked.stdout) == (2, True)
    (tmp_path / "empty.dat").write_bytes(struct.pack("<IQ", 1, 0))
    empty = live(tmp_path / "empty.dat", *arguments[1:], "-q")
    assert (empty.returncode, empty.stderr.count("no camera ever gave an image")) == (2, 1)
    monkeypatch.setattr("tracker.live.cameras.OPENING", 0.5)
    names = ("not one of 3", "absent0.mp4", "absent1.mp4", "absent2.mp4")
    assert_one_line_error(live(*arguments, "-q"), *names)
    assert_one_line_error(live(*arguments, "--check"), *names)


def test_a_check_of_one_set_of_images_states_no_rate(live):
    shown = live(DATA, "--check", "--seconds", 0.01).stdout.splitlines()[0]
    assert shown.endswith(" sets in 0.0 s")


def test_a_check_tells_of_the_cameras_and_exits_with_1_where_one_is_dark(tmp_path, live, monkeypatch):
    monkeypatch.setattr("tracker.live.camera_check.MOST_AGE", 10.0)  # a busy machine takes its time
    result = well(live(DATA, "--check", "--speed", "5"))
    assert "nothing is wrong with the cameras" in result.stdout
    assert all(name in result.stdout for name in CAMERAS)
    shutil.copytree(DATA, tmp_path / "dark")
    for path in (tmp_path / "dark").glob("*/camera180.jpg"):
        write_picture(path, cv2.imread(str(path)) // 10)
    result = live(tmp_path / "dark", "--check", "--speed", 5)
    assert result.returncode == 1
    assert "camera180: dark" in result.stdout
    assert "camera60: " not in result.stdout


@pytest.mark.parametrize(
    ("option", "writes", "what"),
    [
        ("--record=log.h5", "tracker.logs.hdf5_writer.Hdf5LogWriter.append", "recording"),
        ("--rrd=view.rrd", "tracker.viz.rerun_scene.Scene.show", "view"),
    ],
)
def test_a_file_that_ends_is_reported_even_with_quiet(option, writes, what, tmp_path, live, monkeypatch):
    if what == "view":
        pytest.importorskip("rerun", reason="rerun: no module rerun")
    monkeypatch.setattr(writes, Mock(side_effect=tracker.errors.LogError("no space is left")))
    result = live(DATA, option, "--quiet", folder=tmp_path)
    assert result.returncode == 2
    assert (result.stdout, result.stderr) == ("", f"tracker: the {what} has ended: no space is left\n")


def test_a_jump_is_not_taken_for_a_fault_of_a_camera_that_is_called_stamps():
    statistics = Statistics()
    statistics.hear(replace(moment(0), faults={"stamps": "the buffer failed"}))
    statistics.hear(replace(moment(1), jump="went back by 3.000 s"))
    summary = statistics.summary(0, ())
    assert "faulty in 1 of 2 sets; last: the buffer failed" in summary
    assert "faulty in 1 of 2 sets; last: went back by 3.000 s" in summary


def test_the_summary_names_cameras_in_their_order_and_a_fault_once(tmp_path):
    statistics, counts = Statistics(), {"camera60": 0, "camera180": 3}
    for number in range(3):
        faults = {"camera180": "too small", "camera60": "frozen"}
        statistics.hear(replace(moment(number), faults=faults, fault_counts=counts))
    recorder = SimpleNamespace(recorded=0, path=tmp_path / "log.h5", left_out=0, went_back=0, fault=None)
    lines = statistics.summary(0, ["camera180: too small", "a listener"], recorder).splitlines()
    begins = ["sets", "status", "no", "latency", "camera60", "camera180", "recorded", "fault"]
    assert [line.split()[0] for line in lines] == begins
    assert lines[-2].split() == ["recorded", "nothing"]
    assert not statistics.seen
    statistics.hear(moment(3, (np.zeros((16, 16, 3), np.uint8),)))
    assert statistics.seen
    assert "never found" in statistics.summary(0, ())
    assert lines[-1].endswith("a listener")


def test_a_fault_of_one_set_is_in_the_next_line_and_in_the_summary(monkeypatch):
    now = 100.0
    monkeypatch.setattr("tracker.cli.live_outputs.time.monotonic", lambda: now)
    statistics = Statistics()
    for number in range(10):
        faults = {"camera60": "the buffer failed"} if number == 3 else {}
        statistics.hear(replace(moment(number, pose=estimate()), faults=faults))
    assert statistics.due() is None
    now += 1.1
    line = statistics.due()
    assert "tracking" in line
    assert line.endswith("camera60: the buffer failed (1 of 10 sets)")
    statistics.hear(moment(10, pose=estimate()))
    now += 1.1
    assert "buffer" not in statistics.due()
    assert "never found" not in statistics.summary(0, ())
    assert "camera60        faulty in 1 of 11 sets; last: the buffer failed" in statistics.summary(0, ())


def test_lines_end_after_ten_seconds_without_images(monkeypatch):
    now = 100.0
    monkeypatch.setattr("tracker.cli.live_outputs.time.monotonic", lambda: now)
    statistics, lines = Statistics(), []
    for _ in range(60):
        now += 1.1
        lines.append(statistics.due())
    assert sum(line is not None for line in lines) == 10
    assert lines[9].endswith("no images for ten seconds; waiting for the next")
    statistics.hear(moment(0, pose=estimate()))
    now += 1.1
    assert "tracking" in statistics.due()


def test_swapped_cameras_are_reported_once_after_two_looks_and_never_after_the_object_is_found(monkeypatch):
    monkeypatch.setattr("tracker.cli.live_outputs.FIRST_LOOK", 0.0)
    with tracker.open_log(DATA) as log:
        follower, images = tracker.ObjectTracker("cube_v2", log.rig), log[7].images
    swapped = moment(1, (images[1], images[0], images[2]))
    lookout = Lookout(lambda: follower)
    warnings = [lookout.look(swapped) for _ in range(3)]
    assert warnings == [None, "the images of camera60 and camera180 look swapped", None]
    found = follower.detect(images)
    assert found.object_pose.confidence > 0.9
    lookout = Lookout(lambda: pytest.fail("it looks"))
    assert lookout.look(None) is None
    assert lookout.look(replace(moment(0, tuple(images)), observation=found)) is None
    assert lookout.look(swapped) is None
