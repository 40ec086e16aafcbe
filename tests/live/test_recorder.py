import itertools
import subprocess
import sys
import threading
import time

import h5py
import numpy as np
import pytest

import tracker
from tests.helpers import ROOT
from tests.helpers.filmed import RIG
from tests.helpers.moments import estimate, moment
from tracker.errors import LiveError, LogError
from tracker.live.listeners import WAITING, Recorder
from tracker.logs.hdf5_writer import Hdf5LogWriter
from tracker.logs.pictures import to_bayer

COUNT = len(RIG)


def images(seed, shape=(270, 270, 3)):
    rng = np.random.default_rng(seed)
    return tuple(rng.integers(0, 256, shape, np.uint8) for _ in range(COUNT))


def record(path, moments):
    recorder = Recorder(path, RIG)
    for one in moments:
        recorder(one)
    recorder.close()
    return recorder


def test_raw_pixels_are_read_back_to_the_bit_with_the_calibration_of_their_size(tmp_path):
    raws = [images(n, (540, 540)) for n in range(3)]
    recorder = record(tmp_path / "log.h5", [moment(n, images(n), raw) for n, raw in enumerate(raws)])
    assert (recorder.recorded, recorder.left_out, recorder.fault) == (3, 0, None)
    with tracker.open_log(tmp_path / "log.h5") as log:
        assert log.camera_names == RIG.names
        assert [frame.timestamp for frame in log] == pytest.approx([1000.0, 1000.1, 1000.2])
        for frame, raw in zip(log, raws, strict=True):
            assert all(np.array_equal(mine, its) for mine, its in zip(frame.raw, raw, strict=True))
            assert frame.camera_timestamps[2] == pytest.approx(frame.timestamp - 0.002)
        for mine, its in zip(log.rig, RIG.resized(540, 540), strict=True):
            assert mine.matrix == pytest.approx(its.matrix)


def test_cameras_of_different_sizes_are_refused_before_there_is_a_file(tmp_path):
    rig = tracker.CameraRig((RIG.resized(540, 540)[0], *RIG.cameras[1:]))
    with pytest.raises(LiveError, match=rf"found {RIG.names[0]} 540×540.* expected cameras of one size"):
        Recorder(tmp_path / "log.h5", rig)
    assert not list(tmp_path.iterdir())


def test_colours_are_kept_as_such_a_sensor_measures_them_and_poses_go_with_them(tmp_path):
    given = images(1)
    record(tmp_path / "log.h5", [moment(0, given, pose=estimate(0.05)), moment(1, (None, *given[1:]))])
    with tracker.open_log(tmp_path / "log.h5") as log:
        first, second = log
    assert np.array_equal(first.raw[0], to_bayer(given[0]))
    assert first.recorded_pose.position[0] == 0.05
    assert second.recorded_pose is None
    assert not second.raw[0].any()


def test_what_cameras_were_set_to_is_kept(tmp_path, run_here):
    settings = ({"ExposureTime": 1500.0, "Gain": 0}, {"BalanceWhiteAuto": "Off", "Gamma": float("nan")}, {})
    recorder = Recorder(tmp_path / "log.h5", RIG, lambda: settings)
    recorder(moment(0, images(1)))
    recorder.close()
    with tracker.open_log(tmp_path / "log.h5") as log:
        assert log.settings == {"camera60": settings[0], "camera180": {"BalanceWhiteAuto": "Off"}}
    shown = run_here("info", tmp_path / "log.h5").stdout
    assert "camera60 ExposureTime 1500.0, Gain 0" in shown


def test_settings_that_are_damaged_are_refused(tmp_path):
    record(tmp_path / "log.h5", [moment(0, images(1))])
    for content in (b"[1]", b'{"Gain": NaN}', b"{", b'{"Gain": {}}'):
        with h5py.File(tmp_path / "log.h5", "a") as file:
            file.pop("camera_info/camera60/settings", None)
            file["camera_info/camera60/settings"] = np.frombuffer(content, np.uint8)
        with tracker.open_log(tmp_path / "log.h5") as log, pytest.raises(LogError, match="camera60/settings"):
            _ = log.settings


def test_nothing_is_written_before_there_is_a_picture(tmp_path):
    recorder = record(tmp_path / "log.h5", [moment(n, (None,) * COUNT) for n in range(3)])
    assert recorder.recorded == 0
    assert not list(tmp_path.iterdir())


def test_a_full_disk_ends_the_recording_and_nothing_else(tmp_path, monkeypatch):
    def full(writer, *_):
        raise LogError("log.h5: cannot be written: No space left on device")

    monkeypatch.setattr(Hdf5LogWriter, "append", full)
    recorder = record(tmp_path / "log.h5", [moment(n, images(n)) for n in range(5)])
    assert "No space left" in recorder.fault
    recorder(moment(9, images(9)))  # and no word


def test_what_the_disk_does_not_take_in_time_is_left_out_and_counted(tmp_path, monkeypatch):
    go_on, append = threading.Event(), Hdf5LogWriter.append

    def slow(writer, *arguments):
        go_on.wait(20)
        append(writer, *arguments)

    monkeypatch.setattr(Hdf5LogWriter, "append", slow)
    recorder, given = Recorder(tmp_path / "log.h5", RIG), images(3)
    for n in range(WAITING + 5):
        recorder(moment(n, given))  # returns at once
    assert recorder.left_out >= 4
    go_on.set()
    recorder.close()
    assert recorder.recorded + recorder.left_out == WAITING + 5


RECORD = """
import itertools, sys, time
from pathlib import Path
import numpy as np
from tests.helpers.filmed import RIG
from tests.helpers.moments import moment
from tracker.live.listeners import Recorder

recorder, image = Recorder(Path(sys.argv[1]), RIG), np.zeros((270, 270, 3), np.uint8)
for number in itertools.count():
    recorder(moment(number, (image,) * 3))
    print(number, flush=True)
    time.sleep(0.05)
"""


@pytest.mark.slow
def test_of_a_process_that_is_killed_no_more_than_a_second_is_lost(tmp_path):
    command = [sys.executable, "-c", RECORD, str(tmp_path / "log.h5")]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) as process:
        given = [time.monotonic() for _ in itertools.islice(process.stdout, 31)]  # when each was handed over
        process.kill()
    with tracker.open_log(tmp_path / "log.h5") as log:
        frames = list(log)
        assert "ended before it had finished" in log.fault
    # A second between flushes, and as much for a machine that is busy.
    assert given[-1] - given[len(frames) - 1] < 2.0
    stamps = np.array([frame.timestamp for frame in frames])
    assert stamps == pytest.approx(1000 + 0.1 * np.arange(len(frames)))
