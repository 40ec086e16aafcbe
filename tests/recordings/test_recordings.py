import dataclasses
import gzip
import os
import shutil
import struct
import sys
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest

import tracker
from tests.helpers import contents
from tests.helpers.full_disk import no_file_longer_than
from tests.helpers.log_writers import make_content, native_bytes, write_native, write_picture
from tests.helpers.pose_logs import assert_same, random_poses
from tests.helpers.reading import frames_of, peak_memory
from tests.helpers.recording_stubs import NoiseTracker, make_job, tiny_rig, write_log
from tracker.calibration.files import Calibrated, calibration_text
from tracker.errors import CalibrationError, LogError, TrackerError
from tracker.files import write_together, writing
from tracker.logs import open_log
from tracker.logs.folder import write_folder
from tracker.logs.frame import LogFrame, with_stamps
from tracker.logs.hdf5_writer import write_hdf5
from tracker.logs.opening import recording_files
from tracker.poses.exports import write_bop, write_csv, write_parquet, write_tum
from tracker.poses.file import read_poses, write_poses
from tracker.recordings import Options, run, track
from tracker.recordings.track import answers, code, fingerprint
from tracker.summaries.summary import summary

FRAMES = 50


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_log(tmp_path_factory.mktemp("plain"), FRAMES)


@pytest.fixture(scope="module")
def expected(log, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file of poses that one process writes in one go."""
    output = tmp_path_factory.mktemp("expected") / "poses.h5"
    run(make_job(log, output))
    return output


def test_every_frame_is_there_once_as_a_loop_of_ones_own_has_it(log, expected):
    poses, mine, frames = read_poses(expected), NoiseTracker(), frames_of(log)
    assert poses.index.tolist() == list(range(FRAMES))
    assert poses.timestamp.tolist() == [frame.newest for frame in frames]
    assert poses.recorded.has_pose.tolist() == [frame.recorded_pose is not None for frame in frames]
    assert poses.about.source == "camera_data.dat"
    loop = [mine.update(frame.images, frame.stamps).filtered_object_pose.position for frame in frames]
    assert (poses.filtered.position == np.array(loop)).all()


class Frames(list):
    episode_starts = (0,)


def test_each_image_has_its_own_stamp_and_a_frame_that_of_its_newest(tmp_path):
    # The frames' own stamps are 60 ms late. Images are missing: of all cameras, then of the one that leads;
    # then two clocks differ by seconds.
    nan, given, image = np.nan, [], np.full((8, 8, 3), 99, np.uint8)
    stamps = [
        [nan] * 3, [0.0, 0.01, 0.02], [nan] * 3, [0.2, 0.21, 0.22], [0.3, 0.31, 0.45], [0.4, 0.41, nan],
        [3.6, 0.6, 0.6],
    ]  # fmt: skip
    frames = (
        LogFrame(k, time, np.array(row), tuple(None if np.isnan(t) else image for t in row), None, None)
        for k, (time, row) in enumerate(zip([nan, *np.arange(0.08, 0.6, 0.1)], stamps, strict=True))
    )
    frames = Frames(with_stamps(frames))
    finder = SimpleNamespace(update=lambda images, timestamp: given.append(timestamp))
    found = [frame.timestamp for frame, _ in answers(tmp_path, frames, finder)]
    np.testing.assert_allclose(found, [0.019, 0.02, 0.12, 0.22, 0.45, 0.45, 0.58])
    assert (np.diff(found) > 0).all()
    for found, row in zip(given, [0.019, stamps[1], 0.12, *stamps[3:5], 0.45, 0.58], strict=True):
        np.testing.assert_allclose(found, row)


def test_a_log_that_has_to_be_read_through_gives_the_same(expected, tmp_path):
    packed, plain = write_log(tmp_path / "packed", FRAMES, packed=True), read_poses(expected)
    done: list[int] = []
    result = run(make_job(packed, tmp_path / "poses.h5"), done.append)
    assert sum(done) == result.new == result.expected == FRAMES
    assert_same(dataclasses.replace(result.poses, about=plain.about), plain)


def test_what_is_whole_is_not_tracked_again(log, expected, tmp_path):
    job = make_job(log, tmp_path / "poses.h5")
    first = run(job)
    os.utime(job.output, ns=(0, 0))
    done: list[int] = []
    again = run(dataclasses.replace(job), done.append)
    assert (again.new, again.expected, sum(done)) == (0, FRAMES, FRAMES)
    assert_same(first.poses, again.poses)
    assert job.output.stat().st_mtime_ns == 0
    assert job.output.read_bytes() == expected.read_bytes()
    assert os.listdir(tmp_path) == ["poses.h5"]


@pytest.mark.parametrize(
    "damage", ["cut", "changed", "emptied", "removed", "of another job", "a part", "posed frames"]
)
def test_what_is_not_whole_or_of_another_job_is_tracked_again(damage, log, expected, tmp_path):
    job, whole, poses = make_job(log, tmp_path / "poses.h5"), expected.read_bytes(), read_poses(expected)
    changed = bytearray(whole)
    changed[len(whole) // 2] ^= 1
    content = {"cut": whole[:-100], "changed": bytes(changed), "emptied": b""}.get(damage)
    part = {"a part": poses[5:8], "posed frames": poses[poses.filtered.has_pose]}.get(damage)
    if content is not None:
        job.output.write_bytes(content)
    elif part is not None:
        write_poses(job.output, part)
    elif damage == "of another job":
        run(make_job(log, job.output, model=tracker.load_object("cube_v1")))
    assert run(job).new == FRAMES
    assert job.output.read_bytes() == whole


@pytest.mark.parametrize(("stop", "count"), [(None, 4), (2, 2), (9, 4)])
@pytest.mark.parametrize("packed", [False, True])
def test_the_frames_that_a_truncated_recording_lacks_are_expected(packed, stop, count, tmp_path):
    log, data = tmp_path / "camera_data.dat", native_bytes(make_content(4))
    log.write_bytes(gzip.compress(data[:-700]) if packed else data[:-700])
    job = make_job(log, tmp_path / "poses.h5", stop=stop, recover=True)
    whole = min(count, 3)
    for new in (whole, 0):  # tracked, then read
        result = run(job)
        assert (result.expected, len(result.poses), result.new) == (count, whole, new)
        assert (result.fault is None) == (packed and count == 2)  # its end was not read


def test_the_poses_can_be_had_without_a_file(tmp_path):
    log = write_log(tmp_path / "log", 5)
    before = sorted(tmp_path.rglob("*"))
    poses = track(log, "cube_v2").poses
    assert sorted(tmp_path.rglob("*")) == before
    assert poses.index.tolist() == [0, 1, 2, 3, 4]
    assert_same(poses, track(log, "cube_v2", output=tmp_path / "poses.h5").poses)
    assert_same(poses, read_poses(tmp_path / "poses.h5"))


@pytest.mark.parametrize(
    "changed", ["pose/solve.py", "tasks/move_object.py", "summaries/summary.py", "viz/paint.py"]
)
def test_other_code_for_poses_or_their_sums_is_in_the_fingerprint(changed, tmp_path, monkeypatch):
    root = Path(tracker.__file__).parent
    shutil.copytree(root, tmp_path, dirs_exist_ok=True)
    monkeypatch.setattr(
        sys.modules[fingerprint.__module__], "__file__", str(tmp_path / "recordings/track.py")
    )
    before = code.__wrapped__()
    assert before == code()
    (tmp_path / "pose" / ".#solve.py").symlink_to("user@host.1:2")  # of an editor that has solve.py open
    (tmp_path / changed).write_text("")
    assert (code.__wrapped__() == before) == changed.startswith("viz")


def test_whatever_the_poses_depend_on_is_in_the_fingerprint(log, tmp_path):
    job = make_job(log, tmp_path / "poses.h5")
    again = write_log(tmp_path / "again", 5)
    changes = [
        {"model": tracker.load_object("cube_v1")},
        {"colors": tracker.load_colors("cube_v1")},
        {"rig": tracker.CameraRig(tuple(camera.resized(28, 25) for camera in job.recipe.rig))},
        {"rig": dataclasses.replace(job.recipe.rig, arena=tracker.Arena(table=0.01))},
        {"start": 1},
        {"stop": 3},
        {"recover": True},
        {"rig": None},
        {"correct_halved_principal_point": True},
    ]
    prints = [fingerprint(make_job(log, tmp_path / "poses.h5", **change)) for change in changes]

    def of_again() -> list[str]:
        paths = (again, again.parent)
        return [fingerprint(make_job(path, tmp_path / "poses.h5", rig=None)) for path in paths]

    prints += of_again()
    os.utime(again, (0, 0))
    prints += of_again()
    os.utime(again.parent / "camera60.yml", (0, 0))
    prints += of_again()
    (again.parent / "left.yml").touch()  # the calibration of a camera of that name
    prints += of_again()
    assert len({*prints, fingerprint(job)}) == len(prints) + 1
    assert fingerprint(job) == fingerprint(make_job(log, tmp_path / "other.h5"))
    (again.parent / "poses.h5").touch()
    (again.parent / "notes.txt").touch()
    assert of_again() == prints[-2:]


def test_a_known_name_is_no_file_whatever_the_working_folder_holds(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("cube_v2", "cuboid_2x2x8_v2", "own.toml", "own.npz"):
        (tmp_path / name).touch()
    known = Options("cube_v2", colors="cuboid_2x2x8_v2")
    assert known.absolute() == known
    own = Options("own.toml", colors="own.npz").absolute()
    assert (own.object, own.colors) == (str(tmp_path / "own.toml"), str(tmp_path / "own.npz"))


def test_what_is_behind_a_link_beside_a_store_or_in_a_film_s_frame_is_in_the_fingerprint(tmp_path):
    folder, store = tmp_path / "folder", tmp_path / "a.zarr" / "data.mdb"
    film = tmp_path / "film" / "ground_truth.json"
    stated = [film, film.with_name("000000") / "camera60.yml"]
    for file in (tmp_path / "images" / "000000.png", store, tmp_path / "camera60.yml", *stated):
        file.parent.mkdir(exist_ok=True)
        file.touch()
    folder.mkdir()
    (folder / "camera60").symlink_to(tmp_path / "images")
    (folder / "back").symlink_to(folder)
    inside = film.parent, "film/000000/camera60.yml"
    for path, changed in ((folder, "images/000000.png"), (store, "camera60.yml"), inside):
        job = make_job(path, tmp_path / "poses.h5", rig=None)
        before = fingerprint(job)
        os.utime(tmp_path / changed, (0, 0))
        assert fingerprint(job) != before
    (folder / "away").symlink_to(tmp_path)
    assert recording_files(folder) == [folder / "camera60" / "000000.png"]


class Complaining(NoiseTracker):
    def update(self, *_: object) -> None:
        raise tracker.TrackerError("images: all are None")


@pytest.mark.parametrize(
    ("changes", "while_it_runs", "raised", "message"),
    [
        ({"make_tracker": Complaining}, lambda log: None, LogError, "frame 0: images"),
        ({"start": -1}, lambda log: None, LogError, "start: found -1, expected the number of a frame"),
        ({"start": "3"}, lambda log: None, LogError, "start: found '3', expected"),
        ({"stop": 1.5}, lambda log: None, LogError, "stop: found 1.5, expected"),
        ({"start": FRAMES}, lambda log: None, LogError, f"frames 0 to {FRAMES - 1}"),
        ({"start": 2, "stop": 2}, lambda log: None, LogError, "found frames from 2 to 2 asked for"),
        ({}, lambda log: log.write_bytes(log.read_bytes() + b"more"), LogError, "changed while it was read"),
        ({}, Mock(side_effect=KeyboardInterrupt), KeyboardInterrupt, None),
    ],
    ids=["complaining", "before 0", "a text", "half", "beyond the end", "none", "it grows", "interrupted"],
)
def test_a_run_that_fails_leaves_nothing(changes, while_it_runs, raised, message, tmp_path):
    log = write_log(tmp_path / "log", FRAMES)
    with pytest.raises(raised, match=message):
        run(make_job(log, tmp_path / "poses.h5", **changes), lambda _: while_it_runs(log))
    assert os.listdir(tmp_path) == ["log"]


@pytest.mark.parametrize("given", ["log/camera_data.dat", "log"], ids=["a file", "its folder"])
@pytest.mark.parametrize("output", ["log/camera_data.dat", "link.h5", "log/camera60.yml"])
def test_a_recording_is_never_overwritten_by_its_poses(given, output, tmp_path):
    log = write_log(tmp_path / "log", 3)
    (tmp_path / "link.h5").symlink_to(log)
    before = contents(tmp_path)
    with pytest.raises(LogError, match=r"output .*: that is the recording or its calibration, expected"):
        track(tmp_path / given, "cube_v2", output=tmp_path / output)
    assert contents(tmp_path) == before


@pytest.mark.parametrize("name", ["notes.txt", "other.h5", "log", "pipe", "v1.h5"])
def test_what_holds_no_poses_of_the_object_is_never_replaced(name, tmp_path):
    log = write_log(tmp_path / "log", 3)
    (tmp_path / "notes.txt").write_text("keep")
    os.mkfifo(tmp_path / "pipe")
    with open_log(log) as opened:
        write_hdf5(tmp_path / "other.h5", opened, tiny_rig(), lambda _: None)
    run(make_job(log, tmp_path / "v1.h5", model=tracker.load_object("cube_v1")))
    before = contents(tmp_path)
    message = rf"output .*{name}: found (a .*(no poses|older|device)|poses of cube_v1), expe"
    with pytest.raises(LogError, match=message):
        track(log, "cube_v2", output=tmp_path / name)
    assert contents(tmp_path) == before


def test_damage_is_named_and_what_is_whole_recovered(tmp_path):
    content = make_content(FRAMES)
    content.stamps[7] = -1e-3  # which cannot be
    log = write_native(write_log(tmp_path / "log", FRAMES), content, poses=1)
    with pytest.raises(LogError, match="frame 7"):
        run(make_job(log, tmp_path / "poses.h5"))
    assert not (tmp_path / "poses.h5").exists()
    result = run(make_job(log, tmp_path / "poses.h5", recover=True))
    assert "frame 7" in result.fault
    assert result.poses.index.tolist() == [k for k in range(FRAMES) if k != 7]
    assert result.new == FRAMES - 1
    assert run(make_job(log, tmp_path / "poses.h5", recover=True)).new == 0


def test_an_image_whose_link_leads_nowhere_costs_its_frame_only(tmp_path):
    for camera, images in zip(tiny_rig().names, make_content(4).raw.swapaxes(0, 1), strict=True):
        for number, image in enumerate(images):
            write_picture(tmp_path / "log" / camera / f"{number:06d}.png", image)
    link = tmp_path / "log" / "camera180" / "000002.png"
    link.unlink()
    link.symlink_to(tmp_path / "elsewhere.png")
    job = make_job(tmp_path / "log", tmp_path / "poses.h5", recover=True)
    result = run(job)
    assert result.fault == f"{link}: cannot be read: No such file or directory"
    assert result.poses.index.tolist() == [0, 1, 3]
    assert run(job).new == 0
    shutil.copy(link.with_name("000001.png"), link.resolve())
    assert run(job).poses.index.tolist() == [0, 1, 2, 3]


@pytest.mark.parametrize("data", [struct.pack("<IQ", 1, 0), bytes(8)])
def test_a_log_may_be_empty_and_gives_no_poses(data, tmp_path):
    log = tmp_path / "camera_data.dat"
    log.write_bytes(data)
    assert frames_of(log) == []
    result = run(make_job(log, tmp_path / "poses.h5"))
    assert len(result.poses) == len(read_poses(tmp_path / "poses.h5")) == result.expected == 0
    assert summary(result)["position_std_median_mm"] is None


def test_memory_ends_where_an_episode_starts(log, tmp_path, monkeypatch):
    monkeypatch.setattr(tracker.logs.Log, "episode_starts", (0, 7, 20, 45))
    run(make_job(log, tmp_path / "poses.h5"))
    poses = read_poses(tmp_path / "poses.h5")
    same = (poses.filtered.position == poses.measured.position).all(axis=1)
    fresh = np.flatnonzero(same & poses.measured.has_pose)
    assert set(fresh) <= {0, 7, 20, 45}
    assert 7 in fresh or not poses.measured.has_pose[7]


def test_memory_does_not_grow_with_the_recording(tmp_path):
    def peak(count: int) -> int:
        job = make_job(write_log(tmp_path / f"{count}", count), tmp_path / f"{count}.h5")
        with peak_memory() as used:
            run(job)
        return used[0]

    peak(2)
    # A frame's images are 8 kB in colour, its poses 1 kB.
    assert peak(200) < peak(50) + 150 * 4000


def write_calibration(path, camera):
    with writing(CalibrationError, path):
        write_together([(path, calibration_text(Calibrated(camera)))])


WRITERS = {
    "poses.h5": lambda path, poses, log: write_poses(path, poses),
    "poses.csv": lambda path, poses, log: write_csv(path, poses),
    "poses.tum": lambda path, poses, log: write_tum(path, poses),
    "bop.csv": lambda path, poses, log: write_bop(path, poses, poses.about.rig[0]),
    "poses.parquet": lambda path, poses, log: write_parquet(path, poses),
    "camera60.yml": lambda path, poses, log: write_calibration(path, poses.about.rig[0]),
    "log.h5": lambda path, poses, log: write_hdf5(path, log, tiny_rig(), lambda count: None),
    "folder": lambda path, poses, log: write_folder(path, log, tiny_rig(), lambda count: None),
}
NEW = "log.h5", "folder"
"""Written only where nothing is yet."""


@pytest.fixture
def whole(tmp_path, name) -> tuple:
    if name == "poses.parquet":
        pytest.importorskip("pyarrow", reason="cluster: no module pyarrow")
    with open_log(write_native(tmp_path / "log", make_content(4))) as log:
        yield random_poses(np.random.default_rng(0), 50), log


@pytest.mark.parametrize("name", WRITERS)
def test_a_place_that_cannot_be_written_is_reported_in_one_line(name, whole, tmp_path):
    read_only = tmp_path / "read_only"
    read_only.mkdir(mode=0o555)
    if os.access(read_only, os.W_OK):  # who may do everything needs a folder of the kernel's own
        read_only = Path("/sys")
    for folder in (read_only, tmp_path / "none", tmp_path / "nul\0"):
        with pytest.raises(TrackerError) as raised:
            WRITERS[name](folder / name, *whole)
        assert str(raised.value).startswith(f"{folder / name}: cannot be written: ")
        assert "\n" not in str(raised.value)
        assert not (folder / name).exists()


@pytest.mark.parametrize("name", [name for name in WRITERS if name not in ("camera60.yml", *NEW)])
@pytest.mark.parametrize("path", [None, 3, b"poses"])
def test_what_is_no_path_is_named(path, name, whole):
    with pytest.raises(LogError, match=f"output: found {path!r}, expected a path"):
        WRITERS[name](path, *whole)


@pytest.mark.parametrize("path", ["nothing.dat", 300 * "a"])
def test_a_recording_that_is_missing_is_an_error_of_the_tracker(path):
    with pytest.raises(LogError, match=f"^{path}: cannot be read: "):
        tracker.track(path, "cube_v2")


@pytest.mark.parametrize("name", WRITERS)
def test_a_full_disk_is_reported_in_one_line_and_leaves_what_was_there(name, tmp_path, whole):
    (tmp_path / "out").mkdir()
    target = tmp_path / "out" / name
    if name not in NEW:
        target.write_text("old")
    with no_file_longer_than(700), pytest.raises(TrackerError) as raised:
        WRITERS[name](target, *whole)
    assert f"{target}: cannot be written" in str(raised.value)
    assert "File too large" in str(raised.value)
    assert "\n" not in str(raised.value)
    assert [path.read_text() for path in target.parent.iterdir()] == ([] if name in NEW else ["old"])


@pytest.mark.parametrize("name", NEW)
def test_a_recording_that_grows_while_it_is_converted_is_reported(name, tmp_path, whole):
    poses, log = whole
    with (tmp_path / "log").open("ab") as file:
        file.write(b"more")
    (tmp_path / "out").mkdir()
    with pytest.raises(TrackerError, match="found bytes after frame 3"):
        WRITERS[name](tmp_path / "out" / name, poses, log)
    assert os.listdir(tmp_path / "out") == []
