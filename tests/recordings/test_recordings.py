from __future__ import annotations

import dataclasses
import os
import struct
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import tracker
from tests.helpers import ROOT, run_python
from tests.helpers.pose_logs import assert_same, random_poses
from tests.helpers.recording_stubs import make_job, write_log
from tracker.errors import LogError
from tracker.logs.poses_file import read_poses
from tracker.pose.result import CameraUse
from tracker.recordings import Tracked, Workers, track
from tracker.recordings.fingerprint import fingerprint
from tracker.recordings.parts import PART, RUN_UP, cut, runs
from tracker.recordings.summary import summary, to_look_at

FRAMES = 2 * PART + 50


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_log(tmp_path_factory.mktemp("plain"), FRAMES)


@pytest.fixture(scope="module")
def expected(log, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """The file of poses that one process writes in one go."""
    output = tmp_path_factory.mktemp("expected") / "poses.h5"
    track(make_job(log, output))
    return output.read_bytes()


@pytest.fixture(scope="module")
def two():
    with Workers(2) as workers:
        yield workers


class Break:
    """Interrupts after so many frames."""

    def __init__(self, frames: int) -> None:
        self.left = frames

    def __call__(self, count: int) -> None:
        self.left -= count
        if self.left <= 0:
            raise KeyboardInterrupt


@given(
    st.integers(0, 2000),
    st.integers(0, 3000),
    st.sets(st.integers(1, 4000), max_size=5).map(lambda starts: (0, *sorted(starts))),
)
def test_parts_cover_every_frame_once(first, count, starts):
    parts = cut(first, first + count, starts)
    frames = [index for part in parts for index in range(part.start, part.stop)]
    assert frames == list(range(first, first + count))
    for part in parts:
        assert first <= part.run_up <= part.start < part.stop
        assert part.start - part.run_up <= RUN_UP
        assert not [start for start in starts if part.run_up < start <= part.start]
        wanted = max(first, part.start - RUN_UP)
        assert part.run_up == wanted or part.run_up in starts


@given(st.integers(0, 20), st.integers(1, 5), st.booleans())
def test_runs_hold_every_part_once(count, workers, sequential):
    parts = cut(0, count * PART)
    shared = runs(parts, count=workers, sequential=sequential)
    assert [part for run in shared for part in run] == parts
    assert all(shared)
    assert len(shared) <= (workers if sequential else count)


def test_every_frame_is_there_once_with_its_stamp_and_recorded_pose(log, expected, tmp_path):
    (tmp_path / "poses.h5").write_bytes(expected)
    poses = read_poses(tmp_path / "poses.h5")
    with tracker.open_log(log) as opened:
        frames = list(opened)
    assert poses.index.tolist() == list(range(FRAMES))
    assert poses.timestamp.tolist() == [frame.timestamp for frame in frames]
    assert poses.recorded is not None
    assert poses.recorded.has_pose.tolist() == [frame.recorded_pose is not None for frame in frames]
    assert poses.about.source == "camera_data.dat"


def test_a_part_starts_without_memory_of_what_was_before_its_run_up(log, expected, tmp_path):
    (tmp_path / "poses.h5").write_bytes(expected)
    whole = read_poses(tmp_path / "poses.h5")
    track(make_job(log, tmp_path / "later.h5", first=PART - RUN_UP))
    later = read_poses(tmp_path / "later.h5")
    assert later.index[0] == PART - RUN_UP
    same = later.filtered.position[RUN_UP : 2 * RUN_UP] == whole.filtered.position[PART : PART + RUN_UP]
    assert same.all()
    assert not (later.filtered.position[:RUN_UP] == whole.filtered.position[PART - RUN_UP : PART]).all()


def test_two_processes_write_the_same_bytes_as_one(log, expected, two, tmp_path):
    told: list[int] = []
    result = track(make_job(log, tmp_path / "poses.h5"), two, told.append)
    assert (tmp_path / "poses.h5").read_bytes() == expected
    assert sum(told) == result.new == result.expected == FRAMES
    assert os.listdir(tmp_path) == ["poses.h5"]


@pytest.mark.parametrize("shared", [False, True])
def test_a_log_that_has_to_be_read_through_gives_the_same(shared, log, expected, two, tmp_path):
    packed = write_log(tmp_path / "packed", FRAMES, packed=True)
    with tracker.open_log(packed) as opened:
        assert not opened.random_access
    track(make_job(packed, tmp_path / "poses.h5"), two if shared else None)
    assert (tmp_path / "poses.h5").read_bytes() == expected


@pytest.mark.parametrize("shared", [False, True])
def test_a_run_that_was_broken_off_goes_on_where_it_was(shared, log, expected, two, tmp_path):
    job, workers = make_job(log, tmp_path / "poses.h5"), two if shared else Workers()
    with pytest.raises(KeyboardInterrupt):
        track(job, workers, Break(FRAMES - 20))
    assert os.listdir(tmp_path) == [".poses.h5.parts"]
    told: list[int] = []
    result = track(job, workers, told.append)
    assert result.new < FRAMES
    assert sum(told) == FRAMES
    assert (tmp_path / "poses.h5").read_bytes() == expected
    assert os.listdir(tmp_path) == ["poses.h5"]


def test_a_damaged_part_is_made_again(log, expected, tmp_path):
    job = make_job(log, tmp_path / "poses.h5")
    with pytest.raises(KeyboardInterrupt):
        track(job, progress=Break(2 * PART + 1))
    part = job.parts_folder / "000001.h5"
    part.write_bytes(part.read_bytes()[:-100])
    result = track(job)
    assert result.new == FRAMES - PART
    assert (tmp_path / "poses.h5").read_bytes() == expected


def test_parts_of_another_job_are_dropped(log, expected, tmp_path):
    output = tmp_path / "poses.h5"
    with pytest.raises(KeyboardInterrupt):
        track(make_job(log, output, model=tracker.load_object("cube_v1")), progress=Break(PART + 1))
    assert track(make_job(log, output)).new == FRAMES
    assert output.read_bytes() == expected


def test_whatever_the_poses_depend_on_is_in_the_fingerprint(log, tmp_path):
    job = make_job(log, tmp_path / "poses.h5")
    again = write_log(tmp_path / "again", 5)
    changes = [
        {"model": tracker.load_object("cube_v1")},
        {"colors": tracker.load_colors("cube_v1")},
        {"rig": tracker.CameraRig(tuple(camera.resized(28, 25) for camera in job.rig))},
        {"rig": dataclasses.replace(job.rig, arena=tracker.Arena(table=0.01))},
        {"first": 1},
        {"last": 3},
        {"recover": True},
        {"log": again},
        {"log": again.parent},
    ]
    prints = [
        str(fingerprint(make_job(**({"log": log, "output": tmp_path / "poses.h5"} | change))))
        for change in changes
    ]
    os.utime(again, (0, 0))
    prints += [str(fingerprint(make_job(path, tmp_path / "poses.h5"))) for path in (again, again.parent)]
    assert len({*prints, str(fingerprint(job))}) == len(prints) + 1
    assert fingerprint(job) == fingerprint(make_job(log, tmp_path / "poses.h5"))


def spoil_stamp(log: Path, frame: int, frames: int) -> None:
    """Give a record of a native log a stamp that cannot be."""
    content = bytearray(log.read_bytes())
    record = (len(content) - 12) // frames
    struct.pack_into("<d", content, 12 + frame * record, -1.0)
    log.write_bytes(content)


def test_a_damaged_frame_is_named_and_nothing_is_written(two, tmp_path):
    log = write_log(tmp_path / "log", FRAMES)
    spoil_stamp(log, PART + 7, FRAMES)
    for workers in (Workers(), two):
        with pytest.raises(LogError, match=f"record {PART + 7}"):
            track(make_job(log, tmp_path / "poses.h5"), workers)
        assert not (tmp_path / "poses.h5").exists()
    contents = []
    for workers in (Workers(), two):
        result = track(make_job(log, tmp_path / "poses.h5", recover=True), workers)
        assert result.fault is not None
        assert f"record {PART + 7}" in result.fault
        assert result.poses.index.tolist() == [k for k in range(FRAMES) if k != PART + 7]
        contents.append((tmp_path / "poses.h5").read_bytes())
    assert contents[0] == contents[1]


@pytest.mark.parametrize("packed", [False, True])
def test_what_is_left_of_a_truncated_log_is_recovered(packed, two, tmp_path):
    log = write_log(tmp_path / "log", FRAMES, packed=packed)
    content = log.read_bytes()
    log.write_bytes(content[: len(content) * 6 // 10])
    with pytest.raises(LogError, match="camera_data"):
        track(make_job(log, tmp_path / "poses.h5"))
    one, other = (
        track(make_job(log, tmp_path / f"{count}.h5", recover=True), workers)
        for count, workers in ((1, Workers()), (2, two))
    )
    assert_same(one.poses, other.poses)
    assert one.fault == other.fault
    assert one.fault
    assert PART < len(one.poses) < FRAMES
    assert one.poses.index.tolist() == list(range(len(one.poses)))


def test_a_tracker_s_complaint_names_the_frame(log, tmp_path):
    with pytest.raises(LogError, match="frame 0: images"):
        track(make_job(log, tmp_path / "poses.h5", make_tracker=Complaining))


class Complaining:
    def __init__(self, *_: object) -> None: ...

    def reset(self) -> None: ...

    def update(self, *_: object) -> None:
        raise tracker.TrackerError("images: all are None")


def test_a_range_beyond_the_log_is_refused(log, tmp_path):
    with pytest.raises(LogError, match=f"{FRAMES} frames"):
        track(make_job(log, tmp_path / "poses.h5", first=FRAMES))


def test_a_log_without_frames_gives_no_poses(tmp_path):
    log = tmp_path / "camera_data.dat"
    log.write_bytes(struct.pack("<IQ", 1, 0))
    result = track(make_job(log, tmp_path / "poses.h5"))
    assert len(result.poses) == len(read_poses(tmp_path / "poses.h5")) == 0
    assert summary(result)["position_std_median_mm"] is None


def test_memory_ends_where_an_episode_starts(log, tmp_path, monkeypatch):
    monkeypatch.setattr(tracker.logs.Log, "episode_starts", (0, 7, 290, 400))
    track(make_job(log, tmp_path / "poses.h5"))
    poses = read_poses(tmp_path / "poses.h5")
    fresh = np.flatnonzero(
        (poses.filtered.position == poses.measured.position).all(axis=1) & poses.measured.has_pose
    )
    assert set(fresh) <= {0, 7, 290, 400}
    assert 7 in fresh or not poses.measured.has_pose[7]


def test_the_summary_counts_what_is_there(log, tmp_path):
    tracked = track(make_job(log, tmp_path / "poses.h5"))
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


MEMORY = """
import resource, struct, sys
from pathlib import Path
from tests.helpers.recording_stubs import make_job
from tests.helpers import make_camera
from tracker.calibration.rig import CameraRig
from tracker.recordings import track
folder, count = Path(sys.argv[1]), int(sys.argv[2])
folder.mkdir()
record = 8 + 3 * (13 + 270 * 270 + 8)
with (folder / "camera_data.dat").open("wb") as file:  # black, so that it needs little room on disk
    file.write(struct.pack("<IQ", 1, count))
    file.truncate(12 + count * record)
    for k in range(count):
        for camera in range(3):
            file.seek(12 + k * record + 8 + camera * (record - 8) // 3)
            file.write(struct.pack("<iiiB", 270, 270, 0, 1))
rig = CameraRig(tuple(make_camera(azimuth) for azimuth in (60, 180, 300)))
track(make_job(folder / "camera_data.dat", folder / "poses.h5", rig=rig))
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="system: units of ru_maxrss")
def test_memory_does_not_grow_with_the_recording(tmp_path):
    peaks = []
    for count in (350, 800):
        result = run_python(["-c", MEMORY, tmp_path / str(count), count], ROOT, check=True)
        peaks.append(int(result.stdout))
    # The images of the frames that the longer one has more are 290 MB.
    assert peaks[1] < peaks[0] + 40
