import copy
import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from tests.helpers.pose_logs import (
    answer,
    arrays_of,
    assert_same,
    make_about,
    moved,
    random_pose,
    random_poses,
)
from tracker.errors import LogError
from tracker.geometry import so3
from tracker.pose.result import CameraUse, Observation, PoseEstimate, Status
from tracker.poses.columns import FilteredColumns, MeasuredColumns, PoseColumns
from tracker.poses.file import PosesBuilder
from tracker.poses.poses import Poses, compare


def test_slices_and_masks_keep_rows_together(rng):
    poses = random_poses(rng, 12)
    mask = poses.measured.has_pose
    chosen = {name: array[mask] for name, array in arrays_of(poses).items()}
    np.testing.assert_equal(arrays_of(poses[mask]), chosen)
    assert_same(poses[::3], poses[np.arange(0, 12, 3)])


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda poses: poses[0], "frames of poses: found the number 0, expected a slice, a mask"),
        (lambda poses: poses.columns("guessed"), "expected one of measured, filtered, recorded"),
        (lambda poses: poses.columns("recorded"), r"a\.dat: found no recorded poses"),
        (lambda poses: of(poses, source="a\0b"), "source: found"),
        (lambda poses: of(poses, source="\udcff"), "source: found"),
        (lambda poses: of(poses, source=3), "source: found"),
    ],
)
def test_what_poses_do_not_have_or_what_does_not_belong_together_is_refused(make, message, rng):
    with pytest.raises(LogError, match=message):
        make(random_poses(rng, 3, recorded=False))


def of(poses: Poses, **changes) -> Poses:
    return dataclasses.replace(poses, about=make_about(**changes))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"index": np.array([0, 2, 2])}, "index: row 2: found 2"),
        ({"index": np.array([-1, 0, 1])}, "index: row 0: found -1"),
        ({"index": np.arange(3.0)}, "index: found float64"),
        ({"timestamp": np.array([0, np.nan, 1])}, "timestamp: row 1: found nan"),
        ({"timestamp": np.array([0, 1, 2e18])}, "timestamp: row 2: found 2e.18, expected a time in seconds"),
        ({"timestamp": ["0", "1", "2"]}, "timestamp: found a list of 3, expected numbers"),
        ({"timestamp": np.arange(3).astype("datetime64[ns]")}, "timestamp: found datetime64"),
        ({"timestamp": np.zeros(2)}, r"timestamp: found shape \(2,\)"),
        ({"status": np.zeros(3)}, "status: found float64"),
        ({"status": np.array(["lost"])}, r"status: found .* of shape \(1,\)"),
        ({"filtered": FilteredColumns.nothing(2)}, "filtered: found 2 frames, expected 3"),
        ({"filtered": MeasuredColumns.nothing(3)}, "filtered: found MeasuredColumns, expected Filt"),
        ({"measured": None}, "measured: found NoneType"),
        ({"recorded": PoseColumns.nothing(4)}, "recorded: found 4 frames"),
        ({"cameras": np.full((3, 2), "used")}, r"cameras: found .* of shape \(3, 2\), .* \(3, 3\)"),
        ({"cameras": np.zeros((3, 3), np.uint8)}, "cameras: found uint8"),
    ],
)
def test_columns_that_do_not_fit_together_are_refused(rng, changes, message):
    with pytest.raises(LogError, match=message):
        dataclasses.replace(random_poses(rng, 3), **changes)


def test_poses_are_shown_as_counts(rng):
    poses = random_poses(rng, 5, share=1)
    text = repr(poses)
    assert text.startswith(f"Poses({poses.about.object_name} in {poses.about.source!r}: 5 frames over ")
    assert text.endswith("5 with a measured and 5 with a filtered pose)")
    assert "0 frames, 0 with" in repr(poses[:0])


def test_columns_hold_what_was_appended_and_later_changes_do_not_reach_them(rng):
    first, second, old = random_pose(rng), random_pose(rng, moving=True), random_pose(rng)
    uses = (CameraUse.USED, CameraUse.CONTRADICTING, CameraUse.NO_IMAGE)
    given = copy.deepcopy((first, second, old))
    builder = PosesBuilder(make_about())
    own = Observation(PoseEstimate(**vars(given[0])), None, Status.NO_OBJECT_COLORS, cameras=uses)
    builder.append(4, 1.5, own)
    builder.append(7, 1.75, answer(None, given[1], "coasting"), given[2])
    for pose in given:
        pose.position[:] = 0
    poses = builder.build()
    assert len(poses) == 2
    assert poses.index.tolist() == [4, 7]
    assert poses.timestamp.tolist() == [1.5, 1.75]
    assert poses.status.tolist() == ["no_object_colors", "coasting"]
    assert poses.cameras.tolist() == [["used", "contradicting", "no_image"], [""] * 3]
    assert poses.measured.has_pose.tolist() == [True, False]
    assert poses.filtered.has_pose.tolist() == poses.recorded.has_pose.tolist() == [False, True]
    held = (first, poses.measured, 0), (second, poses.filtered, 1), (old, poses.recorded, 1)
    for pose, columns, row in held:
        for name in columns.ROW_SHAPES:
            assert np.array_equal(getattr(columns, name)[row], getattr(pose, name)), name
            assert np.isnan(getattr(columns, name)[1 - row]).all(), name
    for name, array in arrays_of(poses).items():
        assert not array.flags.writeable, name


def test_a_builder_goes_on_after_a_build(rng):
    builder = PosesBuilder(make_about())
    assert len(builder.build()) == 0
    rough = SimpleNamespace(position=np.zeros(3), orientation=np.array([0, 0.6, 0, 0.8]))
    builder.append(0, 0.0, answer(None, None, "lost"), rough)
    early = builder.build()
    assert early.cameras is None
    assert np.isnan(early.recorded.confidence[0])
    builder.append(1, 0.1, answer(random_pose(rng), None, "found"))
    assert len(early) == 1
    assert len(builder.build()) == 2


NO_STAMPS = "1.5", None, np.datetime64("2026-01-01"), 2 * 10**18, np.inf, 10**400


@pytest.mark.parametrize(
    ("stamp", "make", "message"),
    [
        (0.0, lambda pose: answer(None, pose, ""), "filtered pose: velocity: found none"),
        (0.0, lambda pose: answer(flat(pose), None, ""), r"measured pose: position: found shape \(2,\), exp"),
        (0.0, lambda _: answer(None, None, "", ["used"] * 2), "cameras: found 2, expected 3: camera60, came"),
        *[(stamp, lambda pose: answer(pose, None, ""), "3: timestamp: found .*, exp") for stamp in NO_STAMPS],
    ],
)
def test_an_answer_that_does_not_fit_is_refused_before_it_is_added(stamp, make, message, rng):
    builder = PosesBuilder(make_about())
    with pytest.raises(LogError, match=message):
        builder.append(3, stamp, make(random_pose(rng)))
    assert len(builder.build()) == 0


def flat(pose: SimpleNamespace) -> SimpleNamespace:
    return SimpleNamespace(**{**vars(pose), "position": np.zeros(2)})


def test_differences_to_recorded_poses_are_those_put_in(rng):
    builder = PosesBuilder(make_about())
    for number in range(10):
        pose = random_pose(rng, moving=True)
        axis = rng.normal(size=3)
        turn = so3.exp(axis / np.linalg.norm(axis) * np.radians(number))
        rotation = turn @ so3.matrix_from_quaternion(pose.orientation)
        old = moved(rotation, pose.position + np.array([0, 0, 1e-3 * number]))
        # Frame 0: only recorded; frame 9: only found.
        found = None if number == 0 else pose
        builder.append(number, number / 10, answer(found, found, "found"), None if number == 9 else old)
    builder.append(10, 1.0, answer(None, None, "lost"))
    shares = dict.fromkeys(("share_only_found", "share_only_recorded", "share_neither"), 1 / 11)
    medians = dict.fromkeys(("position_median_mm", "angle_median_deg"), 4.5)
    tails = dict.fromkeys(("position_p90_mm", "angle_p90_deg"), 7.3)
    expected = {"frames": 11, "share_both": 8 / 11} | shares | medians | tails
    poses = builder.build()
    for found in (poses.measured, poses.filtered):
        assert compare(found, poses.recorded) == pytest.approx(expected)


def test_a_comparison_without_common_frames_says_none(rng):
    empty = PoseColumns.nothing(4)
    found = compare(empty, empty)
    assert found["position_median_mm"] is found["angle_p90_deg"] is None
    assert found["share_neither"] == 1
    assert compare(empty[:0], empty[:0])["share_neither"] is None
