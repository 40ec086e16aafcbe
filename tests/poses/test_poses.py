from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tests.helpers import make_camera
from tests.helpers.pose_logs import (
    arrays_of,
    assert_same,
    make_about,
    random_poses,
)
from tracker.calibration.rig import CameraRig
from tracker.errors import LogError
from tracker.poses.columns import FilteredColumns, MeasuredColumns, PoseColumns
from tracker.poses.poses import concatenate


def test_parts_joined_are_the_whole(rng):
    whole = random_poses(rng, 20)
    assert_same(concatenate([whole[:7], whole[7:7], whole[7:]]), whole)
    assert_same(concatenate([whole]), whole)


def test_slices_and_masks_keep_rows_together(rng):
    poses = random_poses(rng, 12)
    mask = poses.measured.has_pose
    chosen = arrays_of(poses[mask])
    for name, array in arrays_of(poses).items():
        assert np.array_equal(chosen[name], array[mask], equal_nan=array.dtype.kind == "f"), name
    assert_same(poses[::3], poses[np.arange(0, 12, 3)])


def test_parts_without_recorded_poses_join_those_with(rng):
    first, second = random_poses(rng, 3, recorded=False), random_poses(rng, 4, share=1, first=3)
    joined = concatenate([first, second])
    assert joined.recorded.has_pose.tolist() == [False] * 3 + [True] * 4
    assert concatenate([first]).recorded is None


def test_parts_without_a_word_on_the_cameras_join_those_with(rng):
    first, second = random_poses(rng, 3, cameras=False), random_poses(rng, 4, share=1, first=3)
    joined = concatenate([first, second])
    assert (joined.cameras[:3] == "").all()
    assert joined.cameras[3:].tolist() == second.cameras.tolist()
    assert concatenate([first]).cameras is None


def test_sources_of_parts_are_listed(rng):
    whole = random_poses(rng, 6)
    second = dataclasses.replace(whole[3:], about=make_about(source="b.dat"))
    assert concatenate([whole[:3], second]).about.source == "a.dat, b.dat"


def test_parts_of_different_things_are_refused(rng):
    whole = random_poses(rng, 6)
    other = CameraRig((make_camera(60), make_camera(180), make_camera(301, "camera300")))
    for change in ({"object_name": "cuboid_2x2x8_v2"}, {"rig": other}):
        with pytest.raises(LogError, match="part 1: found"):
            concatenate([whole[:3], dataclasses.replace(whole[3:], about=make_about(**change))])
    with pytest.raises(LogError, match="row 3: found 0, expected frame numbers"):
        concatenate([whole[:3], whole[:3]])
    with pytest.raises(LogError, match="at least one"):
        concatenate([])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"index": np.array([0, 2, 2])}, "index: row 2: found 2"),
        ({"index": np.array([-1, 0, 1])}, "index: row 0: found -1"),
        ({"index": np.arange(3.0)}, "index: found float64"),
        ({"timestamp": np.array([0, np.nan, 1])}, "timestamp: row 1: found nan"),
        ({"timestamp": np.zeros(2)}, r"timestamp: found shape \(2,\)"),
        ({"status": np.zeros(3)}, "status: found float64"),
        ({"status": np.array(["lost"])}, r"status: found .* of shape \(1,\)"),
        ({"filtered": FilteredColumns.nothing(2)}, "filtered: found 2 frames, expected 3"),
        (
            {"filtered": MeasuredColumns.nothing(3)},
            "filtered: found MeasuredColumns, expected FilteredColumns",
        ),
        ({"measured": None}, "measured: found NoneType"),
        ({"recorded": PoseColumns.nothing(4)}, "recorded: found 4 frames"),
        ({"cameras": np.full((3, 2), "used")}, r"cameras: found .* of shape \(3, 2\), .* \(3, 3\)"),
        ({"cameras": np.zeros((3, 3), np.uint8)}, "cameras: found uint8"),
    ],
)
def test_columns_that_do_not_fit_together_are_refused(rng, changes, message):
    with pytest.raises(LogError, match=message):
        dataclasses.replace(random_poses(rng, 3), **changes)


@pytest.mark.parametrize("text", ["a\0b", "\udcff", 3])
def test_texts_that_no_file_can_hold_are_refused(text):
    with pytest.raises(LogError, match="source: found"):
        make_about(source=text)


def test_an_unknown_kind_is_refused(rng):
    poses = random_poses(rng, 2, recorded=False)
    with pytest.raises(LogError, match="expected one of measured, filtered, recorded"):
        poses.columns("guessed")
    with pytest.raises(LogError, match=r"a\.dat: found no recorded poses"):
        poses.columns("recorded")
