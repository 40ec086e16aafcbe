import contextlib
import dataclasses
import itertools
import subprocess
import sys
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest

import tracker
from tests.helpers import RIG, ROOT
from tests.helpers.full_disk import no_file_longer_than
from tests.helpers.moments import estimate, moment
from tests.helpers.reading import change, frames_of, put
from tests.viz.test_rerun_scene import entities
from tracker.cli.live_outputs import Statistics
from tracker.errors import LiveError, LogError
from tracker.live import listeners
from tracker.live.listeners import WAITING, Recorder, RerunView
from tracker.logs.hdf5_writer import Hdf5LogWriter
from tracker.logs.pictures import to_bayer

MODEL = tracker.load_object("cube_v2")


@pytest.fixture
def path(tmp_path):
    return tmp_path / "log.h5"


def images(seed, shape=(270, 270, 3)):
    return tuple(np.random.default_rng(seed).integers(0, 256, (len(RIG), *shape), np.uint8))


def record(path, *moments, settings=tuple):
    with contextlib.closing(Recorder(path, RIG, settings)) as recorder:
        for one in moments:
            recorder(one)
    return recorder


def test_raw_pixels_are_read_back_to_the_bit_with_the_calibration_of_their_size(path):
    raws = [images(n, (540, 540)) for n in range(3)]
    recorder = record(path, *(moment(n, images(n), raw) for n, raw in enumerate(raws)))
    assert (recorder.recorded, recorder.left_out, recorder.fault) == (3, 0, None)
    with tracker.open_log(path) as log:
        assert log.camera_names == RIG.names
        assert [frame.timestamp for frame in log] == pytest.approx([1000.0, 1000.1, 1000.2])
        for frame, raw in zip(log, raws, strict=True):
            assert np.array_equal(frame.raw, raw)
            assert frame.camera_timestamps[2] == pytest.approx(frame.timestamp - 0.002)
        for mine, its in zip(log.rig, RIG.resized(540, 540), strict=True):
            assert mine.matrix == pytest.approx(its.matrix)


def test_a_lagging_camera_or_all_may_miss_an_image(path):
    moments, given = [], images(1)
    shown = given, (*given[:2], None), given, (None,) * 3, (None,) * 3, (None, *given[1:]), given
    for n, its in enumerate(shown):
        one = moment(n, its)
        # As a source stamps it: a missing image with the moment's own time, a lagging one with an older.
        stamps = (*one.taken.stamps[:2], one.timestamp - (0.0 if its[2] is None else 0.15))
        moments.append(dataclasses.replace(one, taken=dataclasses.replace(one.taken, stamps=stamps)))
    recorder = record(path, *moments)
    assert (recorder.recorded, recorder.fault) == (7, None)
    frames = frames_of(path)
    for frame, one in zip(frames, moments, strict=True):
        assert [image is None for image in frame.images] == [image is None for image in one.taken.images]
    late = [frame.timestamp - frame.camera_timestamps[2] for frame in frames]
    assert late == pytest.approx([0.15, np.nan, 0.15, np.nan, np.nan, 0.15, 0.15], nan_ok=True)
    assert [frame.newest for frame in frames] == pytest.approx(
        [1000, 1000.1, 1000.2, 1000.3, 1000.4, 1000.499, 1000.6]
    )


def test_a_clock_that_is_set_back_by_seconds_ends_no_recording(path):
    recorder = record(path, *(moment(n, images(1)) for n in (0, 3, 1, 2, 3, 4)))
    assert (recorder.recorded, recorder.went_back, recorder.fault) == (4, 2, None)
    assert "  2 lost, because their stamps are before" in Statistics().summary(0, (), recorder)
    assert [frame.timestamp for frame in frames_of(path)] == pytest.approx([1000.0, 1000.3, 1000.3, 1000.4])
    for first, second, fault in ((1000, 0, "goes back by 100 s"), (0, 36_010, "goes forward by 3601 s")):
        path.unlink()
        assert fault in record(path, *(moment(n, images(1)) for n in (first, second))).fault
    path.unlink()
    assert record(path, *(moment(n, images(1)) for n in (0, 36_000))).fault is None


def test_cameras_of_different_sizes_are_refused_before_there_is_a_file(path):
    rig = tracker.CameraRig((RIG.resized(540, 540)[0], *RIG.cameras[1:]))
    with pytest.raises(LiveError, match=rf"found {RIG.names[0]} 540×540.* expected cameras of one size"):
        Recorder(path, rig)
    assert not list(path.parent.iterdir())


def test_colours_are_kept_as_such_a_sensor_measures_them_and_poses_go_with_them(path):
    given = images(1)
    record(path, moment(0, given, pose=estimate(0.05)), moment(1, (None, *given[1:])))
    first, second = frames_of(path)
    assert np.array_equal(first.raw[0], to_bayer(given[0]))
    assert first.recorded_pose.position[0] == 0.05
    assert second.recorded_pose is None
    assert second.raw[0] is None


def test_what_cameras_were_set_to_is_kept_and_refused_where_it_is_damaged(path, run_here):
    settings = ({"ExposureTime": 1500.0, "Gain": 0}, {"BalanceWhiteAuto": "Off", "Gamma": float("nan")}, {})
    record(path, moment(0, images(1)), settings=lambda: settings)
    with tracker.open_log(path) as log:
        assert log.settings == {"camera60": settings[0], "camera180": {"BalanceWhiteAuto": "Off"}}
    assert "camera60 ExposureTime 1500.0, Gain 0" in run_here("info", path).stdout
    for content in (b"[1]", b'{"Gain": NaN}', b"{", b'{"Gain": {}}'):
        change(path, put("camera_info/camera60/settings", np.frombuffer(content, np.uint8)))
        with tracker.open_log(path) as log, pytest.raises(LogError, match="camera60/settings"):
            _ = log.settings


def test_nothing_is_written_before_there_is_a_picture(path):
    recorder = record(path, *(moment(n, (None,) * len(RIG)) for n in range(3)))
    assert recorder.recorded == 0
    assert not list(path.parent.iterdir())


class Gate:
    """Where what a disk or a viewer is given waits until it may go on, or fails."""

    def __init__(self):
        self.error, self.passed = None, []
        self.at_work, self.may_go_on = threading.Event(), threading.Event()

    def take(self, number):
        self.at_work.set()
        assert self.may_go_on.wait(20)
        if self.error is not None:
            raise self.error
        self.passed.append(number)


@pytest.fixture(params=["recorder", "view"])
def gated(request, path, monkeypatch):
    """A listener whose disk or viewer is behind a gate, with that, and for how many moments it has room."""
    gate, append = Gate(), Hdf5LogWriter.append

    def slow(writer, pictures, timestamp, *more):
        gate.take(round(10 * (timestamp - 1000)))
        append(writer, pictures, timestamp, *more)

    monkeypatch.setattr(Hdf5LogWriter, "append", slow)
    scene = SimpleNamespace(show=lambda number, *_: gate.take(number))
    monkeypatch.setattr(listeners, "open_scene", lambda *_: contextlib.nullcontext(scene))
    if request.param == "view":
        return RerunView(None, RIG, MODEL), gate, 1
    return Recorder(path, RIG), gate, WAITING


def test_what_is_not_taken_in_in_time_is_left_out_and_counted_and_holds_up_nobody(gated):
    (listener, gate, room), given, count = gated, images(3), WAITING + 6
    listener(moment(0, given))
    assert gate.at_work.wait(20)
    for number in range(1, count):
        listener(moment(number, given))  # returns at once
    gate.may_go_on.set()
    listener.close()
    assert gate.passed == [0, *range(count - room, count)]
    assert listener.left_out == count - 1 - room


@pytest.mark.parametrize(
    ("error", "fault"),
    [(RuntimeError("it takes no more"), "it takes no more"), (MemoryError(), "MemoryError")],
)
def test_a_full_disk_or_a_viewer_that_is_closed_ends_its_listener_and_nothing_else(gated, error, fault):
    listener, gate, _ = gated
    gate.error = error
    gate.may_go_on.set()
    for number in range(5):
        listener(moment(number, images(number)))
    listener.close()
    assert listener.fault == fault
    listener(moment(9, images(9)))  # and no word


def test_of_a_recording_that_a_full_disk_ended_as_many_sets_are_counted_as_can_be_read(path):
    with no_file_longer_than(1_000_000):
        recorder = record(path, *(moment(n, images(n)) for n in range(9)))
    assert "cannot be written" in recorder.fault
    assert 0 < len(frames_of(path)) == recorder.recorded < 9


def test_images_and_poses_are_in_the_file_of_a_view(tmp_path):
    pytest.importorskip("rerun", reason="rerun: no module rerun")
    with contextlib.closing(RerunView(tmp_path / "live.rrd", RIG, MODEL)) as one:
        one(moment(0, images(1), pose=estimate(0.05)))
    assert one.fault is None
    found = entities(tmp_path / "live.rrd")
    assert {"/world/measured", "/confidence/filtered", "/world/cameras/camera60/image"} <= found


RECORD = """
import itertools, sys, time
from pathlib import Path
import numpy as np
from tests.helpers import make_rig
from tests.helpers.full_disk import no_file_longer_than
from tests.helpers.moments import moment
from tracker.live.listeners import Recorder

recorder, image = Recorder(Path(sys.argv[1]), make_rig()), np.zeros((270, 270, 3), np.uint8)
for number in itertools.count():
    recorder(moment(number, (image,) * 3))
    print(number, flush=True)
    time.sleep(0.05)
"""


@pytest.mark.slow
def test_of_a_process_that_is_killed_no_more_than_a_second_is_lost(path):
    command = [sys.executable, "-c", RECORD, str(path)]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) as process:
        given = [time.monotonic() for _ in itertools.islice(process.stdout, 31)]  # when each was handed over
        process.kill()
    with tracker.open_log(path) as log:
        frames = list(log)
        assert "ended before it had finished" in log.fault
    # A second between flushes, and as much for a machine that is busy.
    assert given[-1] - given[len(frames) - 1] < 2.0
    stamps = np.array([frame.timestamp for frame in frames])
    assert stamps == pytest.approx(1000 + 0.1 * np.arange(len(frames)))
