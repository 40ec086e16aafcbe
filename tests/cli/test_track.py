import contextlib
import dataclasses
import fcntl
import functools
import json
import os
import pty
import re
import shutil
import signal
import struct
import termios
from pathlib import Path

import cv2
import numpy as np
import pytest

import tracker
from tests.calibration.by_object.test_health import film  # noqa: F401
from tests.helpers import contents
from tests.helpers.command import assert_one_line_error, assert_refused, begin, until, well
from tests.helpers.log_writers import make_content, write_native, write_picture
from tests.helpers.pose_logs import assert_same
from tests.helpers.recording_stubs import write_log
from tracker.cli.demo import DATA
from tracker.cli.export import _of_height, _widest, observation
from tracker.cli.track import CONTRADICTED, _calibration_rows
from tracker.files import claimed
from tracker.pose.result import CameraUse, MotionEstimate, Observation, Status
from tracker.poses.file import read_poses
from tracker.viz.overlays import caption, footer

FRAMES = 6
DEMO = (DATA, "--object", "cube_v2", "--to", FRAMES)


@pytest.fixture
def run_here(run_here):
    return functools.partial(run_here, "track")


def test_a_recording_is_tracked_and_written_in_every_format(tmp_path, run_here):
    av = pytest.importorskip("av", reason="video: no module av")
    pytest.importorskip("matplotlib", reason="plot: no module matplotlib")
    base = (*DEMO, "-o", "poses.h5")
    exports = ("--csv", "poses.csv", "--tum", "poses.tum", "--bop", "poses_bop.csv", "--camera", "camera180")
    pictures = ("--video", "overlay.mp4", "--plot", "poses.png")
    result = well(run_here(*base, "--json", *exports, *pictures, folder=tmp_path))
    assert result.stderr == ""
    written = {"poses.h5", "poses.csv", "poses.tum", "poses_bop.csv", "overlay.mp4", "poses.png"}
    assert set(os.listdir(tmp_path)) == written
    truths = json.loads((DATA / "truth.json").read_text())["poses"][:FRAMES]
    truth = [one["position"] for one in truths]
    poses = read_poses(tmp_path / "poses.h5")
    assert np.linalg.norm(poses.measured.position - truth, axis=1).max() < 1e-3
    np.testing.assert_allclose(poses.timestamp - poses.timestamp[0], 0.1 * np.arange(FRAMES), atol=1e-6)
    numbers = json.loads(result.stdout)
    assert (numbers["frames"], numbers["measured"]) == (FRAMES, 1)
    assert numbers["frames_per_second"] > 0
    assert max(numbers["position_std_median_mm"]) < 1
    assert numbers["recorded"] is numbers["fault"] is None
    unused = dict.fromkeys(("contradicting", "no_image", "frozen", "black"), 0)
    assert numbers["cameras"] == dict.fromkeys(("camera60", "camera180", "camera300"), unused)
    for name in ("poses.csv", "poses.tum", "poses_bop.csv"):
        assert len((tmp_path / name).read_text().splitlines()) == FRAMES + 1
    with av.open(str(tmp_path / "overlay.mp4")) as opened:
        pictures = list(opened.decode(video=0))
        assert (len(pictures), opened.streams.video[0].average_rate) == (FRAMES, 10)
    shown = observation(poses, 1)
    assert shown.status.value == poses.status[1]
    assert (shown.object_pose.position == poses.measured.position[1]).all()
    again = run_here(*base, folder=tmp_path)
    rows = dict(re.split(r"  +", line.strip(), maxsplit=1) for line in again.stdout.splitlines())
    assert rows["frames"] == str(FRAMES)
    assert rows["with a pose"].startswith(f"{FRAMES} of {FRAMES} measured")
    assert not any(label.startswith("camera") for label in rows)


def test_two_processes_change_nothing_and_tell_in_order(tmp_path, run_here):
    logs = [write_log(tmp_path / name, frames) for name, frames in (("a", 6), ("b", 2), ("c", 2))]
    base = [*(log.relative_to(tmp_path) for log in logs), "--object", "cube_v2", "--json"]
    for jobs in (1, 2):
        result = run_here(*base, "-o", f"by{jobs}", "--jobs", jobs, folder=tmp_path)
        assert (result.returncode, result.stderr) == (0, "")
        assert [json.loads(line)["log"] for line in result.stdout.splitlines()] == list(map(str, base[:3]))
    one, two = (contents(tmp_path / folder) for folder in ("by1", "by2"))
    assert sum(name.endswith(".h5") for name in one) == 3
    assert one == two


def test_a_camera_that_is_mirrored_is_named_with_what_to_look_at(tmp_path, run_here):
    shutil.copytree(DATA, tmp_path / "film")
    for path in (tmp_path / "film").glob("*/camera180.jpg"):
        write_picture(path, cv2.flip(cv2.imread(str(path)), 1))
    result = run_here(tmp_path / "film", *DEMO[1:], "-o", tmp_path / "poses.h5")
    lines = [line.strip() for line in result.stdout.splitlines()]
    (number,) = (k for k, line in enumerate(lines) if line.startswith("camera"))
    name, remark = re.split(r"  +", lines[number])
    assert name == "camera180"
    share = re.fullmatch(r"contradicts the others in (.*)% of the frames with a measured pose:", remark)
    assert float(share[1]) > 80
    assert "mirrored" in lines[number + 1]
    shown = observation(read_poses(tmp_path / "poses.h5"), FRAMES - 1)
    assert shown.cameras == (CameraUse.USED, CameraUse.CONTRADICTING, CameraUse.USED)


def test_frames_can_be_chosen_and_the_calibration_be_given(tmp_path, run_here):
    base = (*DEMO, "--correct-halved-principal-point", "--from", 2, "--to", 4)
    well(run_here(*base, "-o", tmp_path / "poses.h5", "--calibration", DATA))
    poses = read_poses(tmp_path / "poses.h5")
    assert poses.index.tolist() == [2, 3]
    plain = tracker.CameraRig.load(DATA)
    shift = [a.matrix[0, 2] - b.matrix[0, 2] for a, b in zip(plain, poses.about.rig, strict=True)]
    np.testing.assert_allclose(shift, 0.25)
    well(run_here(*base, "-o", tmp_path / "beside.h5"))
    assert_same(dataclasses.replace(read_poses(tmp_path / "beside.h5"), about=poses.about), poses)


def test_poses_of_another_object_are_replaced_only_where_that_is_asked_for(tmp_path, run_here):
    write_log(tmp_path / "log", 2)
    base = ["log", "-o", "poses.h5", "--object"]
    well(run_here(*base, "cube_v2", folder=tmp_path))
    before = (tmp_path / "poses.h5").read_bytes()
    words = ("poses.h5: found poses of cube_v2", "cuboid_2x2x8_v2", "--overwrite")
    assert_refused(run_here, tmp_path, [*base, "cuboid_2x2x8_v2"], *words)
    well(run_here(*base, "cuboid_2x2x8_v2", "--overwrite", folder=tmp_path))
    assert read_poses(tmp_path / "poses.h5").about.object_name == "cuboid_2x2x8_v2"
    (tmp_path / "poses.h5").write_bytes(before[: len(before) // 2])  # of a damaged file nothing is lost
    well(run_here(*base, "cube_v2", folder=tmp_path))


def test_of_several_recordings_the_whole_ones_are_tracked_and_none_of_them_again(tmp_path, run_here):
    for name in ("first", "second", "third"):
        write_log(tmp_path / name, 3)
    spoilt = tmp_path / "second" / "camera_data.dat"
    spoilt.write_bytes(spoilt.read_bytes()[:-3000])
    logs = [f"{name}/camera_data.dat" for name in ("first", "second", "third")]
    base = [*logs, "--object", "cube_v2", "-o", "all"]
    result = run_here(*base, "--json", folder=tmp_path)
    assert result.returncode == 2
    (line,) = result.stderr.splitlines()
    assert line.startswith("tracker: second/camera_data.dat")
    assert [json.loads(line)["log"] for line in result.stdout.splitlines()] == [logs[0], logs[2]]
    files = [name for name in contents(tmp_path / "all") if "." in name]
    assert files == ["first/camera_data.dat.poses.h5", "third/camera_data.dat.poses.h5"]
    result = well(run_here(*base, "--quiet", "--recover", folder=tmp_path))
    assert result.stdout == ""
    assert result.stderr.startswith("tracker: warning: second/camera_data.dat")
    assert "tracked 1 of 3 frames, the last one is 0" in result.stderr
    for again in (logs[2:], logs):  # one alone has the name that it has among several
        result = run_here(*again, *base[3:], "--recover", "--json", folder=tmp_path)
        assert [json.loads(line)["new"] for line in result.stdout.splitlines()] == [0] * len(again)


def test_a_file_that_another_run_is_writing_is_left_to_it(tmp_path, run_here):
    write_log(tmp_path / "log", 5)
    with claimed(tmp_path / "poses.h5"):
        result = run_here("log", "--object", "cube_v2", "-o", "poses.h5", folder=tmp_path)
    assert_one_line_error(result, "poses.h5", "another run")


def test_pictures_of_a_film_have_one_height():
    picture = np.arange(12, dtype=np.uint8).reshape(4, 1, 3)
    assert _of_height(picture, 3).shape == (3, 1, 3)
    assert (_of_height(picture, 6)[3:] == picture[3]).all()


@pytest.mark.parametrize("width", [520, 1580])
def test_no_caption_of_a_film_is_taller_than_room_is_left_for(width):
    pose = np.full(3, -0.12345), np.full(4, -0.5), 1e-8 * np.eye(6), 1.0
    coasting = MotionEstimate(*pose, velocity=np.zeros(6), velocity_covariance=np.eye(6))
    answers = _widest(), Observation(None, coasting, Status.COASTING)
    room, needed = (len(footer(width, caption("cube_v2", one, "1.0 s"))) for one in answers)
    assert needed <= room


@pytest.fixture(scope="module")
def long(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    root = tmp_path_factory.mktemp("long")
    return [write_log(root / name, 9000) for name in ("one", "two")]


@pytest.mark.parametrize(
    ("jobs", "end", "number"),
    # As a terminal ends all processes of a command, and as one of them is killed.
    [(1, os.killpg, signal.SIGINT), (2, os.killpg, signal.SIGINT), (2, os.kill, signal.SIGKILL)],
)
def test_workers_end_with_an_interrupted_or_killed_run(jobs, end, number, long, tmp_path):
    output = tmp_path / ("poses.h5" if jobs == 1 else "all")
    process = begin("track", *long[:jobs], "--object", "cube_v2", "-o", output, "--jobs", jobs)
    # All its processes are at work, each on a recording.
    until(lambda: len(list(tmp_path.rglob(".*.lock"))) == jobs, process)
    end(process.pid, number)
    # The pipe closes when the last process that holds it has ended.
    out, err = process.communicate(timeout=120)
    printed = {signal.SIGINT: (130, b"tracker: interrupted\n"), signal.SIGKILL: (-signal.SIGKILL, b"")}
    assert (process.returncode, err) == printed[number]
    assert out == b""
    assert not list(tmp_path.rglob("*.h5"))


def test_a_bar_is_shown_on_a_terminal_and_gone_before_an_error(tmp_path, monkeypatch):
    content = make_content(5)
    content.stamps[3] = np.nan
    log = write_native(write_log(tmp_path / "log", 5), content, poses=1)
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 40, 120, 0, 0))
    monkeypatch.setenv("TERM", "xterm")
    process = begin("track", log, "--object", "cube_v2", "-o", tmp_path / "poses.h5", stderr=theirs)
    os.close(theirs)
    shown = b""
    with contextlib.suppress(OSError):  # the other end is closed
        while piece := os.read(ours, 4096):
            shown += piece
    os.close(ours)
    out, _ = process.communicate(timeout=60)
    assert (process.returncode, out) == (2, b"")
    *bars, last = shown.decode().rstrip("\r\n").split("\r")
    assert any("frames/s" in bar for bar in bars)
    assert last.startswith("tracker: ")
    assert "frame 3" in last


def test_track_writes_the_page_and_says_what_is_not_well(film, rig, tmp_path, run_here):  # noqa: F811
    rig.save(tmp_path / "calibration")
    base = (film, "--object", "cube_v2", "--calibration", tmp_path / "calibration")
    page = tmp_path / "health.html"
    result = well(run_here(*base, "-o", tmp_path / "poses.h5", "--health", page, "--json"))
    assert "camera300: brightness" in " ".join(json.loads(result.stdout)["health"])
    assert page.read_text(encoding="utf-8").startswith("<!DOCTYPE html>")


def test_a_calibration_is_named_where_cameras_contradict_each_other_for_long():
    def statuses(share, with_pose):
        return {Status.INCONSISTENT_VIEWS.value: {"share": share, "with_pose": with_pose}}

    (first, *_) = _calibration_rows(statuses(0.5, 1.0))
    assert first[0] == "calibration"
    assert "50.0 %" in first[1]
    # Without poses the status says that there is no object.
    assert not _calibration_rows(statuses(1.0, 0.0))
    assert not _calibration_rows(statuses(CONTRADICTED / 2, 1.0))
    assert not _calibration_rows({})
