from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from tests.helpers import make_camera
from tests.helpers.pose_logs import (
    answer,
    arrays_of,
    assert_same,
    make_about,
    moved,
    random_pose,
    random_poses,
)
from tracker.calibration.rig import CameraRig
from tracker.errors import LogError
from tracker.geometry import so3
from tracker.pose.result import CameraUse, Observation, PoseEstimate, Status
from tracker.poses.builder import PosesBuilder
from tracker.poses.columns import FilteredColumns, MeasuredColumns, PoseColumns
from tracker.poses.poses import compare, concatenate


def test_columns_hold_what_was_appended(rng):
    first, second, old = random_pose(rng), random_pose(rng, moving=True), random_pose(rng)
    builder = PosesBuilder(make_about())
    builder.append(4, 1.5, answer(first, None, "found"))
    builder.append(7, 1.75, answer(None, second, "coasting"), old)
    poses = builder.build()
    assert len(poses) == len(builder) == 2
    assert poses.index.tolist() == [4, 7]
    assert poses.timestamp.tolist() == [1.5, 1.75]
    assert poses.status.tolist() == ["found", "coasting"]
    assert poses.measured.has_pose.tolist() == [True, False]
    assert poses.filtered.has_pose.tolist() == poses.recorded.has_pose.tolist() == [False, True]
    for pose, columns, row in (
        (first, poses.measured, 0),
        (second, poses.filtered, 1),
        (old, poses.recorded, 1),
    ):
        for name in columns.ROW_SHAPES:
            assert np.array_equal(getattr(columns, name)[row], getattr(pose, name)), name
            assert np.isnan(getattr(columns, name)[1 - row]).all(), name


def test_the_trackers_own_observations_are_taken(rng):
    pose = PoseEstimate(**vars(random_pose(rng)))
    builder = PosesBuilder(make_about())
    uses = (CameraUse.USED, CameraUse.CONTRADICTING, CameraUse.NO_IMAGE)
    builder.append(0, 0.0, Observation(pose, None, Status.FOUND, cameras=uses))
    builder.append(1, 0.1, Observation(None, None, Status.NO_OBJECT_COLORS))
    poses = builder.build()
    assert poses.status.tolist() == ["found", "no object colours"]
    assert np.array_equal(poses.measured.covariance[0], pose.covariance)
    assert poses.recorded is None
    assert poses.cameras.tolist() == [["used", "contradicting", "no image"], [""] * 3]


def test_without_a_word_on_the_cameras_nothing_is_said_of_them(rng):
    builder = PosesBuilder(make_about())
    builder.append(0, 0.0, answer(None, None, "lost"))
    assert builder.build().cameras is None


def test_an_answer_about_other_cameras_is_refused_before_it_is_added():
    builder = PosesBuilder(make_about())
    with pytest.raises(LogError, match="cameras: found 2, expected 3: camera60, camera180, camera300"):
        builder.append(0, 0.0, answer(None, None, "lost", ["used"] * 2))
    assert len(builder) == len(builder.build()) == 0


def test_a_builder_goes_on_after_a_build(rng):
    builder = PosesBuilder(make_about())
    assert len(builder.build()) == 0
    builder.append(0, 0.0, answer(None, None, "lost"))
    early = builder.build()
    builder.append(1, 0.1, answer(random_pose(rng), None, "found"))
    assert len(early) == 1
    assert len(builder.build()) == 2


def test_later_changes_of_a_pose_do_not_reach_the_columns(rng):
    pose = random_pose(rng)
    kept = pose.position.copy()
    builder = PosesBuilder(make_about())
    builder.append(0, 0.0, answer(pose, None, "found"))
    pose.position[:] = 0
    poses = builder.build()
    assert np.array_equal(poses.measured.position[0], kept)
    for name, array in arrays_of(poses).items():
        assert not array.flags.writeable, name


def test_a_recorded_pose_may_lack_a_confidence():
    builder = PosesBuilder(make_about())
    rough = SimpleNamespace(position=np.zeros(3), orientation=np.array([0, 0.6, 0, 0.8]))
    builder.append(0, 0.0, answer(None, None, "lost"), rough)
    assert np.isnan(builder.build().recorded.confidence[0])


def test_a_pose_that_lacks_something_is_refused_before_it_is_added(rng):
    builder = PosesBuilder(make_about())
    with pytest.raises(LogError, match="filtered pose: velocity: found none"):
        builder.append(0, 0.0, answer(None, random_pose(rng), "tracking"))
    wrong = random_pose(rng)
    wrong.position = np.zeros(2)
    with pytest.raises(LogError, match=r"measured pose: position: found shape \(2,\), expected \(3,\)"):
        builder.append(0, 0.0, answer(wrong, None, "found"))
    assert len(builder) == len(builder.build()) == 0


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


def good(rng, count=3) -> dict[str, np.ndarray]:
    """Valid columns of filtered poses, the last frame without one."""
    arrays = random_poses(rng, count, share=1).filtered.arrays()
    arrays = {name: array.copy() for name, array in arrays.items()}
    arrays["has_pose"][-1] = False
    for name in FilteredColumns.ROW_SHAPES:
        arrays[name][-1] = np.nan
    return arrays


def indefinite(array):
    array[1] = np.diag([1.0, 1, 1, 1, 1, 1])
    array[1, 0, 1] = array[1, 1, 0] = 1.01


def asymmetric(array):
    array[1] = np.eye(6)
    array[1, 0, 1] = 0.01


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        (
            "position",
            lambda a: a.__setitem__((1, 2), np.nan),
            "position: row 1: found .* nan, expected finite",
        ),
        ("position", lambda a: a.__setitem__(2, 0.0), "position: row 2: found 0 0 0, expected NaN"),
        (
            "orientation",
            lambda a: a.__setitem__(1, 0.0),
            "orientation: row 1: found 0 0 0 0, expected a quat",
        ),
        ("orientation", lambda a: a.__imul__(1.0001), "orientation: row 0: .*length 1"),
        ("confidence", lambda a: a.__setitem__(0, 1.001), "confidence: row 0: found 1.001, expected a prob"),
        ("confidence", lambda a: a.__setitem__(0, np.nan), "confidence: row 0: found nan, expected finite"),
        ("covariance", asymmetric, "covariance: row 1: .*expected a symmetric"),
        ("covariance", indefinite, "covariance: row 1: .*positive semi-definite"),
        ("covariance", lambda a: a.__setitem__((0, 0, 0), -1e-12), "covariance: row 0: .*not negative"),
        ("velocity", lambda a: a.__setitem__((0, 0), np.inf), "velocity: row 0: found inf"),
        ("velocity_covariance", indefinite, "velocity_covariance: row 1: .*positive semi-definite"),
    ],
)
def test_impossible_rows_are_refused(rng, name, change, message):
    arrays = good(rng)
    FilteredColumns(**arrays)
    change(arrays[name])
    with pytest.raises(LogError, match=message):
        FilteredColumns(**arrays)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("position", np.zeros((3, 2)), r"position: found shape \(3, 2\), expected \(3, 3\)"),
        ("position", "text", "position: found str, expected numbers"),
        ("covariance", np.zeros((2, 6, 6)), r"covariance: found shape \(2, 6, 6\)"),
        ("has_pose", np.ones(3), "has_pose: found float64"),
        ("has_pose", np.ones((3, 1), bool), r"has_pose: found bool of shape \(3, 1\)"),
    ],
)
def test_columns_of_another_shape_or_type_are_refused(rng, name, value, message):
    with pytest.raises(LogError, match=message):
        MeasuredColumns(
            **{key: good(rng)[key] for key in ("has_pose", *MeasuredColumns.ROW_SHAPES)} | {name: value}
        )


def test_covariances_of_any_size_are_judged_alike(rng):
    for scale in (1e-12, 1.0, 1e12):
        arrays = good(rng)
        arrays["covariance"] *= scale
        FilteredColumns(**arrays)
        arrays["covariance"][0] = np.eye(6) * scale
        arrays["covariance"][0, 3, 4] = arrays["covariance"][0, 4, 3] = -1.01 * scale
        with pytest.raises(LogError, match="positive semi-definite"):
            FilteredColumns(**arrays)


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


def test_differences_to_recorded_poses_are_those_put_in(rng):
    builder = PosesBuilder(make_about())
    for number in range(10):
        pose = random_pose(rng, moving=True)
        axis = rng.normal(size=3)
        turned = so3.exp(axis / np.linalg.norm(axis) * np.radians(number)) @ so3.matrix_from_quaternion(
            pose.orientation
        )
        old = moved(turned, pose.position + np.array([0, 0, 1e-3 * number]))
        # Frame 0: only recorded; frame 9: only found.
        found = None if number == 0 else pose
        builder.append(number, number / 10, answer(found, found, "found"), None if number == 9 else old)
    builder.append(10, 1.0, answer(None, None, "lost"))
    for kind in ("measured", "filtered"):
        assert compare(builder.build(), kind) == pytest.approx(
            {
                "frames": 11,
                "position_median_mm": 4.5,
                "position_p90_mm": 7.3,
                "angle_median_deg": 4.5,
                "angle_p90_deg": 7.3,
                "share_both": 8 / 11,
                "share_only_found": 1 / 11,
                "share_only_recorded": 1 / 11,
                "share_neither": 1 / 11,
            }
        )


def test_a_comparison_without_common_frames_says_none(rng):
    with pytest.raises(LogError, match="no recorded poses"):
        compare(random_poses(rng, 3, recorded=False))
    empty = dataclasses.replace(random_poses(rng, 4, share=0), recorded=PoseColumns.nothing(4))
    found = compare(empty)
    assert found["position_median_mm"] is found["angle_p90_deg"] is None
    assert found["share_neither"] == 1
    assert compare(empty[:0])["share_neither"] is None
