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
