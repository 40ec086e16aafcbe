from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tests.helpers.pose_logs import (
    answer,
    make_about,
    moved,
    random_pose,
    random_poses,
)
from tracker.errors import LogError
from tracker.geometry import so3
from tracker.poses.builder import PosesBuilder
from tracker.poses.columns import PoseColumns
from tracker.poses.comparison import compare


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
