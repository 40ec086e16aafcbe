import csv
import gzip
import re
import struct

import numpy as np
import pytest

import tracker
from tests.helpers.command import assert_one_line_error
from tests.helpers.log_writers import START, make_content, write_native
from tests.helpers.pose_logs import random_poses
from tracker.errors import LogError
from tracker.logs import RobotLog, paired, read_robot_log
from tracker.poses.file import write_poses

COUNT = 5000  # more than are read at once
TIMES = START + 0.001 * np.arange(COUNT)
STATE = np.arange(COUNT)[:, None] / 1000 + np.arange(27)
"""Positions, velocities and torques of the joints, which change by 1 a second."""


def text(times=TIMES, *, fields=("position", "velocity", "torque")) -> bytes:
    names = [f"observation_{name}_{k}" for name in fields for k in range(9)]
    lines = [" ".join(["#time_index timestamp status_error_status", *names, "applied_action_torque_0"])]
    for k, (time, row) in enumerate(zip(times, STATE, strict=True)):
        lines.append(f"{k} {time!r} 0 {' '.join(map(repr, row[: 9 * len(fields)].tolist()))} 0.5")
    return "\n".join(lines).replace("np.float64(", "").replace(")", "").encode() + b"\n"


def binary(times=TIMES, *, count=COUNT, version=2) -> bytes:
    records = [
        struct.pack("<qdIi64s", k, time, 1, 0, b"") + np.concatenate([row, np.zeros(75)]).tobytes()
        for k, (time, row) in enumerate(zip(times, STATE, strict=True))
    ]
    assert len(records[0]) == 904
    return struct.pack("<IQ", version, count) + b"".join(records)


TEXT, BINARY = text(), binary()


@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize("scale", [1, 1000])
@pytest.mark.parametrize("make", [text, binary])
def test_each_set_of_images_has_the_state_at_its_stamp(make, scale, packed, tmp_path):
    content, path = make_content(60), tmp_path / "robot_data.dat"
    data = make(TIMES * scale)
    path.write_bytes(gzip.compress(data, 1) if packed else data)
    with tracker.open_log(write_native(tmp_path / "camera_data.dat", content)) as log:
        found = list(paired(log[1:], path))
    assert [one.frame.index for one in found] == list(range(1, 60))
    for frame, robot in found:
        seconds = frame.newest - START
        if seconds > TIMES[-1] - START:
            assert np.isnan(robot.position).all()
            assert robot.gap == np.inf
            continue
        np.testing.assert_allclose(robot.position, np.arange(9) + seconds, atol=1e-6)
        np.testing.assert_allclose(robot.torque, 18 + np.arange(9) + seconds, atol=1e-6)
        assert robot.gap == pytest.approx(0.001, abs=1e-6)


def test_arrays_serve_as_a_log_and_gaps_are_told():
    log = RobotLog([0.0, 0.1, 0.1, 0.5], [[0.0], [1.0], [2.0], [4.0]])
    state = log.at(np.array([[-0.01, 0.0, 0.05], [0.3, 0.5, 0.6]]))
    np.testing.assert_allclose(state.position[..., 0], [[np.nan, 0, 0.5], [3, 4, np.nan]])
    np.testing.assert_allclose(state.gap, [[np.inf, 0.1, 0.1], [0.4, 0.4, np.inf]])
    assert state.velocity is None
    assert round(log.at(0.05).gap, 6) == 0.1
    assert list(log.at(np.array([0.2])).columns()) == ["robot_position_0_rad", "robot_gap_s"]


@pytest.mark.parametrize(
    ("times", "position", "message"),
    [
        ([0.0], [[1.0]], "expected times of two steps"),
        ([1.0, 0.0], [[1.0], [2.0]], "step 1: found 0.0"),
        ([0.0, np.nan], [[1.0], [2.0]], "timestamp"),
        ([0.0, 1.0], [[1.0], [np.inf]], "position: found values that are not finite"),
        ([0.0, 1.0], [1.0, 2.0], r"position: found shape \(2,\)"),
        ([0.0, 1.0], [[1.0, 2.0], [3.0]], r"position: found shape \(\)"),
        (["a", "b"], [[1.0], [2.0]], "timestamp"),
    ],
)
def test_arrays_that_are_no_states_are_refused(times, position, message):
    with pytest.raises(LogError, match=message):
        RobotLog(times, position)


@pytest.mark.parametrize("log", ["camera_data.dat", None])
def test_states_are_paired_with_an_opened_log(log):
    with pytest.raises(LogError, match=f"log: found {log!r}, expected Log, as tracker.open_log gives"):
        paired(log, RobotLog([0, 1], [[1], [2]]))


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "expected a robot log"),
        (b"1 2 3\n", "expected a robot log: #time_index"),
        (TEXT.replace(b" ", b","), "no column timestamp, expected it, with spaces between columns"),
        (text(fields=("velocity",)), "found no column observation_position_0"),
        (TEXT.splitlines(keepends=True)[0], "found no steps"),
        (TEXT[:-100], "after the header: .* at row (4999|5000)"),
        (TEXT.replace(b" 0.5\n", b" x\n", 1).replace(b"#time_index", b"#t"), None),
        (TEXT.replace(b"\n0 ", b"\n0 x", 1), "after the header: could not convert string 'x.*at row 0"),
        (TEXT.replace(b"\n7 ", b"\n7 0 ", 1), "after the header: found 32 cells at row 7, expected 31"),
        (re.sub(rb"(?m)^(?=\d)", b"0 ", TEXT), "after the header: found 32 cells at row 0, expected 31"),
        (text([*TIMES[:-1], 1e12]), "timestamp"),
        (BINARY[:-1], "found 4999 records of 904 bytes, expected 5000"),
        (BINARY + b"x", "found bytes after record 4999"),
        (binary(count=2**60), "found 1152921504606846976 steps stated"),
        (BINARY[:9], "steps stated"),
        (binary(version=3), "expected a robot log"),
        (binary(TIMES[::-1]), "timestamp: step 1: found"),
        (gzip.compress(BINARY, 1, mtime=0)[:-50], "end-of-stream marker"),
        (b"\x1f\x8b\x08\x00" + bytes(100), "robot.dat"),
    ],
    ids=lambda value: f"{len(value)} bytes" if isinstance(value, bytes) else None,
)  # fmt: skip
def test_damage_is_one_error_that_names_the_file(data, message, tmp_path):
    path = tmp_path / "robot.dat"
    path.write_bytes(data)
    if message is None:  # in a column that is not read
        assert len(read_robot_log(path).timestamp) == COUNT
        return
    with pytest.raises(LogError, match=message) as error:
        read_robot_log(path)
    assert str(error.value).startswith(str(path))
    assert "\n" not in str(error.value)


def test_longer_logs_than_a_job_are_refused_before_they_fill_the_memory(tmp_path, monkeypatch):
    monkeypatch.setattr("tracker.logs.robot_log.MAX_STEPS", 4500)
    (tmp_path / "robot.csv").write_bytes(TEXT)
    with pytest.raises(LogError, match="more than 4500 steps"):
        read_robot_log(tmp_path / "robot.csv")


def test_states_are_exported_with_the_poses(tmp_path, run_here):
    pq = pytest.importorskip("pyarrow.parquet", reason="cluster: no module pyarrow")
    poses = random_poses(np.random.default_rng(1), 20)
    write_poses(tmp_path / "poses.h5", poses)
    log = tmp_path / "robot.csv"
    log.write_bytes(text(poses.timestamp[0] + 0.05 + TIMES - START))
    base = ["export", "poses.h5", "--robot-log", log]
    done = run_here(*base, "--csv", "a.csv", "--parquet", "a.parquet", folder=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    rows = list(csv.DictReader((tmp_path / "a.csv").open()))
    inside = poses.timestamp >= poses.timestamp[0] + 0.05
    expected = np.where(inside, poses.timestamp - poses.timestamp[0] - 0.05 + 3, np.nan)
    found = [float(row["robot_position_3_rad"] or "nan") for row in rows]
    np.testing.assert_allclose(found, expected, atol=1e-6)
    assert pq.read_table(tmp_path / "a.parquet")["robot_gap_s"].to_pylist()[0] == np.inf
    assert_one_line_error(run_here(*base, "--tum", "a.tum", folder=tmp_path), "--robot-log: found no table")
    log.write_bytes(text(1.0 + TIMES - START))  # of another clock
    done = run_here(*base, "--csv", "a.csv", folder=tmp_path)
    assert (done.returncode, done.stderr.count("\n")) == (0, 1)
    assert "robot.csv: ends before the poses or begins after them" in done.stderr
    log.write_bytes(b"x")
    assert_one_line_error(run_here(*base, "--csv", "b.csv", folder=tmp_path), "robot.csv: found")
