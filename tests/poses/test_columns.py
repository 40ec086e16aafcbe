from __future__ import annotations

import numpy as np
import pytest

from tests.helpers.pose_logs import (
    random_poses,
)
from tracker.errors import LogError
from tracker.poses.columns import FilteredColumns, MeasuredColumns


def good(rng, count=3) -> dict[str, np.ndarray]:
    """Valid columns of filtered poses, the last frame without one."""
    arrays = random_poses(rng, count, share=1).filtered.arrays()
    arrays = {name: array.copy() for name, array in arrays.items()}
    arrays["has_pose"][-1] = False
    for name in FilteredColumns.ROW_SHAPES:
        arrays[name][-1] = np.nan
    return arrays


INDEFINITE, ASYMMETRIC = np.eye(6), np.eye(6)
INDEFINITE[0, 1] = INDEFINITE[1, 0] = 1.01
ASYMMETRIC[0, 1] = 0.01


@pytest.mark.parametrize(
    ("name", "rows", "value", "message"),
    [
        ("position", (1, 2), np.nan, "row 1: found .* nan, expected finite"),
        ("position", 2, 0.0, "row 2: found 0 0 0, expected NaN"),
        ("orientation", 1, 0.0, "row 1: found 0 0 0 0, expected a quat"),
        ("orientation", 0, 0.4, "row 0: .*length 1"),
        ("confidence", 0, 1.001, "row 0: found 1.001, expected a prob"),
        ("confidence", 0, np.nan, "row 0: found nan, expected finite"),
        ("covariance", 1, ASYMMETRIC, "row 1: .*expected a symmetric"),
        ("covariance", 1, INDEFINITE, "row 1: .*positive semi-definite"),
        *[
            ("covariance", 0, scale * INDEFINITE, "row 0: .*positive semi-definite")
            for scale in (1e-12, 1e12)
        ],
        ("covariance", (0, 0, 0), -1e-12, "row 0: .*not negative"),
        ("velocity", (0, 0), np.inf, "row 0: found inf"),
        ("velocity_covariance", 1, INDEFINITE, "row 1: .*positive semi-definite"),
    ],
)
def test_impossible_rows_are_refused(rng, name, rows, value, message):
    arrays = good(rng)
    for scale in (1e-12, 1.0, 1e12):
        FilteredColumns(**{**arrays, "covariance": scale * arrays["covariance"]})
    arrays[name][rows] = value
    with pytest.raises(LogError, match=f"{name}: {message}"):
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
