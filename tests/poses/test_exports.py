import csv
import dataclasses
import os

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.helpers.pose_logs import answer, make_about, random_pose, random_poses
from tracker.errors import LogError
from tracker.geometry import so3
from tracker.poses.exports import write_bop, write_csv, write_parquet, write_tum
from tracker.poses.file import PosesBuilder


def read_csv(path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def read_tum(path) -> np.ndarray:
    """(n, 8), as the benchmark's own tools read it: lines of eight numbers, `#` starts a comment."""
    lines = [line for line in path.read_text().splitlines() if line and not line.startswith("#")]
    return np.array([[float(word) for word in line.split(" ")] for line in lines]).reshape(-1, 8)


def read_bop(path) -> list[dict]:
    """As the challenge's toolkit reads results."""
    head, *lines = path.read_text().splitlines()
    assert head == "scene_id,im_id,obj_id,score,R,t,time"
    rows = []
    for line in lines:
        scene, image, thing, score, rotation, shift, seconds = line.split(",")
        row = {"scene_id": int(scene), "im_id": int(image), "obj_id": int(thing), "score": float(score)}
        row["R"] = np.array(rotation.split(), float).reshape(3, 3)
        rows.append({**row, "t": np.array(shift.split(), float), "time": float(seconds)})
    return rows


def numbers(rows, prefix, names) -> np.ndarray:
    """(n, len(names)) of columns, NaN where a cell is empty."""
    return np.array([[float(row[f"{prefix}_{name}"] or "nan") for name in names] for row in rows])


@settings(max_examples=20)
@given(
    count=st.integers(0, 8),
    share=st.sampled_from([0.0, 0.5, 1.0]),
    recorded=st.booleans(),
    seed=st.integers(0, 99),
)
def test_a_table_has_a_row_a_frame_with_the_same_bits(tmp_path_factory, count, share, recorded, seed):
    path = tmp_path_factory.mktemp("csv") / "trajectory.csv"
    poses = random_poses(np.random.default_rng(seed), count, share=share, recorded=recorded)
    status = np.where(poses.status == "lost", 'far, far "away"', poses.status)
    poses = dataclasses.replace(poses, status=status)
    write_csv(path, poses)
    rows = read_csv(path)
    of_others = random_poses(np.random.default_rng(0), 0, recorded=True).table()
    assert path.read_text(encoding="utf-8").splitlines()[0] == ",".join(of_others)
    assert [int(row["frame"]) for row in rows] == poses.index.tolist()
    assert [float(row["timestamp_s"]) for row in rows] == poses.timestamp.tolist()
    assert [row["status"] for row in rows] == poses.status.tolist()
    uses = np.full((count, 3), "") if poses.cameras is None else poses.cameras
    assert [row["cameras"].split("|") if row["cameras"] else [""] * 3 for row in rows] == uses.tolist()
    for kind in ("measured", "filtered", "recorded") if count else ():
        columns = getattr(poses, kind)
        if columns is None:
            assert np.isnan(numbers(rows, kind, ["x_m", "qw", "confidence"])).all()
            continue
        same = {
            "position": ["x_m", "y_m", "z_m"],
            "orientation": ["qx", "qy", "qz", "qw"],
            "velocity": [f"{name}_per_s" for name in ("vx_m", "vy_m", "vz_m", "wx_rad", "wy_rad", "wz_rad")],
        }
        for column, names in same.items():
            if hasattr(columns, column):
                assert np.array_equal(numbers(rows, kind, names), getattr(columns, column), equal_nan=True)
        if kind != "recorded":
            names = [f"std_{name}" for name in ("x_m", "y_m", "z_m", "rx_rad", "ry_rad", "rz_rad")]
            std = numbers(rows, kind, names)
            variance = np.diagonal(columns.covariance, axis1=1, axis2=2)
            assert np.array_equal(std, np.sqrt(variance), equal_nan=True)


@pytest.mark.parametrize("write", [write_csv, write_parquet])
def test_a_further_column_is_new_and_as_long(write, tmp_path, rng):
    poses = random_poses(rng, 3)
    for name, column in (("frame", np.zeros(3)), ("load_kg", np.zeros(4)), ("load_kg", 1.0)):
        with pytest.raises(LogError, match=rf"column {name}: found shape .*, expected a new name and shape"):
            write(tmp_path / "poses", poses, more={name: column})
    assert not (tmp_path / "poses").exists()


def test_a_parquet_file_may_have_a_name_that_is_no_unicode(tmp_path, rng):
    parquet = pytest.importorskip("pyarrow.parquet", reason="cluster: no module pyarrow")
    path, poses = tmp_path / os.fsdecode(b"poses\xe9.parquet"), random_poses(rng, 3)
    write_parquet(path, poses)
    with path.open("rb") as file:
        assert parquet.read_table(file)["frame"].to_pylist() == poses.index.tolist()


@pytest.mark.parametrize("kind", ["measured", "filtered", "recorded"])
@pytest.mark.parametrize(("count", "share"), [(0, 1.0), (5, 0.0), (12, 0.5)])
def test_a_tum_trajectory_has_the_frames_with_a_pose(tmp_path, rng, kind, count, share):
    poses = random_poses(rng, count, share=share, recorded=False)
    if kind == "recorded":
        with pytest.raises(LogError, match="no recorded poses"):
            write_tum(tmp_path / "a.txt", poses, kind)
        poses = random_poses(rng, 6, share=1)
    write_tum(tmp_path / "a.txt", poses, kind)
    found, columns = read_tum(tmp_path / "a.txt"), getattr(poses, kind)
    chosen = columns.has_pose
    assert np.array_equal(found[:, 0], poses.timestamp[chosen])
    assert np.array_equal(found[:, 1:4], columns.position[chosen])
    assert np.array_equal(found[:, 4:], columns.orientation[chosen])


def test_results_in_the_bop_format_come_back_as_the_same_poses(tmp_path, rng):
    poses = random_poses(rng, 15, first=3)
    for camera in poses.about.rig:
        for kind in ("measured", "filtered", "recorded"):
            write_bop(tmp_path / "a.csv", poses, camera, kind, scene_id=4, object_id=7)
            columns, rows = getattr(poses, kind), read_bop(tmp_path / "a.csv")
            chosen = np.flatnonzero(columns.has_pose)
            assert len(rows) == len(chosen)
            for row, frame in zip(rows, chosen, strict=True):
                assert (row["scene_id"], row["obj_id"], row["time"]) == (4, 7, -1)
                assert row["im_id"] == poses.index[frame]
                assert row["score"] == columns.confidence[frame]
                camera_from_object = np.eye(4)
                camera_from_object[:3, :3], camera_from_object[:3, 3] = row["R"], row["t"] / 1000
                world_from_object = camera.world_from_camera @ camera_from_object
                rotation = so3.matrix_from_quaternion(columns.orientation[frame])
                assert world_from_object[:3, :3] == pytest.approx(rotation, abs=1e-12)
                assert world_from_object[:3, 3] == pytest.approx(columns.position[frame], abs=1e-12)
        write_bop(tmp_path / "a.csv", poses, camera)
        assert {(row["scene_id"], row["obj_id"]) for row in read_bop(tmp_path / "a.csv")} == {(1, 1)}


def test_a_pose_without_a_score_is_no_result(tmp_path, rng):
    builder = PosesBuilder(make_about())
    old = random_pose(rng)
    old.confidence = np.nan
    builder.append(0, 0.0, answer(None, None, "lost"), old)
    poses = builder.build()
    with pytest.raises(LogError, match=r"a\.csv: found recorded poses without a confidence"):
        write_bop(tmp_path / "a.csv", poses, poses.about.rig[0], "recorded")
    write_tum(tmp_path / "a.txt", poses, "recorded")
    assert len(read_tum(tmp_path / "a.txt")) == 1
