"""Poses as a table: a column a number, as the CSV file, Parquet and pandas have them."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import Any

import numpy as np

from tracker.conventions import Array, FloatArray
from tracker.errors import TrackerError
from tracker.poses.columns import FilteredColumns, MeasuredColumns, PoseColumns

_POSE = ("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw", "confidence")
_STD = ("std_x_m", "std_y_m", "std_z_m", "std_rx_rad", "std_ry_rad", "std_rz_rad")
_VELOCITY = ("vx_m_per_s", "vy_m_per_s", "vz_m_per_s", "wx_rad_per_s", "wy_rad_per_s", "wz_rad_per_s")
_VELOCITY_STD = tuple(f"std_{name}" for name in _VELOCITY)

CSV_HEADER = (
    "frame",
    "timestamp_s",
    "status",
    *(f"measured_{name}" for name in (*_POSE, *_STD)),
    *(f"filtered_{name}" for name in (*_POSE, *_STD, *_VELOCITY, *_VELOCITY_STD)),
    *(f"recorded_{name}" for name in _POSE),
    "cameras",
)
"""Columns of the CSV file: always the same, with their units."""

CAMERA_SEPARATOR = "|"
"""Between what became of each camera's picture, in the column `cameras`."""

_AXES = {3: "axis", 4: "xyzw", 6: "twist"}
"""Names of axes by their lengths."""


def numbers_of(
    measured: MeasuredColumns, filtered: FilteredColumns, recorded: PoseColumns | None
) -> FloatArray:
    """(n, k) the columns of numbers under CSV_HEADER, after the status; NaN where there is none."""
    parts = [
        *_pose_and_std(measured),
        *_pose_and_std(filtered),
        filtered.velocity,
        _std(filtered.velocity_covariance),
        *_pose(PoseColumns.nothing(len(measured)) if recorded is None else recorded),
    ]
    return np.concatenate(parts, axis=1)


def camera_cells(cameras: Array) -> Array:
    """(n,) what became of each frame's pictures, as one text; from (n, C) texts."""
    cells = [CAMERA_SEPARATOR.join(uses) if any(uses) else "" for uses in cameras.tolist()]
    return np.array(cells, dtype=np.str_)


def along_frames(kinds: Mapping[str, PoseColumns | None]) -> dict[str, tuple[tuple[str, ...], Array]]:
    """Whole arrays of each kind of poses with the names of their axes, as xarray takes them."""
    found = {}
    for kind, columns in kinds.items():
        for name, array in columns.arrays().items() if columns is not None else ():
            axes = [_AXES[size] + ("_too" if k else "") for k, size in enumerate(array.shape[1:])]
            found[f"{kind}_{name}"] = (("frame", *axes), array)
    return found


def package(name: str) -> Any:
    """A package, or a part of one, that not everybody needs.

    Raises:
        TrackerError: it is missing.
    """
    try:
        return import_module(name)
    except ImportError as error:
        missing = name.partition(".")[0]
        raise TrackerError(f"this needs the package {missing}: pip install {missing}") from error


def _pose(columns: PoseColumns) -> list[FloatArray]:
    return [columns.position, columns.orientation, columns.confidence[:, None]]


def _pose_and_std(columns: MeasuredColumns) -> list[FloatArray]:
    return [*_pose(columns), _std(columns.covariance)]


def _std(covariance: FloatArray) -> FloatArray:
    result: FloatArray = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    return result
