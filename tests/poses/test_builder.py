from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from tests.helpers.pose_logs import (
    answer,
    arrays_of,
    make_about,
    random_pose,
)
from tracker.errors import LogError
from tracker.pose.result import CameraUse, Observation, PoseEstimate, Status
from tracker.poses.builder import PosesBuilder


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
