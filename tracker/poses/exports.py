"""Poses in the formats of others: spreadsheets, pandas, xarray, Parquet, trajectory tools, BOP."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Iterable, Sequence
from importlib import import_module
from typing import Any

import numpy as np

from tracker.conventions import Array, FloatArray
from tracker.errors import LogError, TrackerError
from tracker.files import told_as, whole_file, write_whole
from tracker.geometry import so3
from tracker.geometry.camera import Camera
from tracker.poses.columns import MeasuredColumns, PoseColumns
from tracker.poses.poses import Kind, Poses

BOP_HEADER = ("scene_id", "im_id", "obj_id", "score", "R", "t", "time")
"""First line of a file of BOP results."""

_MM = 1000.0
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


def write_csv(path: str | os.PathLike[str], poses: Poses) -> None:
    """Write one row a frame under CSV_HEADER, whole or not at all; cells without a value are empty.

    Numbers are written so that reading them gives the same bits. Standard deviations are square roots of
    the covariance's diagonal.

    Raises:
        LogError: the file cannot be written.
    """
    numbers = numbers_of(poses)
    heads = zip(poses.index.tolist(), poses.timestamp.tolist(), poses.status.tolist(), strict=True)
    rows = (
        [*head, *("" if value != value else value for value in values), uses]  # only NaN differs from itself
        for head, values, uses in zip(heads, numbers.tolist(), camera_cells(poses), strict=True)
    )
    with told_as(LogError, path):
        write_whole(path, _table(CSV_HEADER, rows))


def write_tum(path: str | os.PathLike[str], poses: Poses, kind: Kind = "filtered") -> None:
    """Write a trajectory in the format of the TUM RGB-D benchmark, whole or not at all.

    A line is `timestamp tx ty tz qx qy qz qw` [s, m], the object in the world; frames without a pose have
    none. `kind` says which poses.

    Raises:
        LogError: the recording has no poses of that kind, or the file cannot be written.
    """
    columns = poses.columns(kind)
    table = np.column_stack([poses.timestamp, columns.position, columns.orientation])[columns.has_pose]
    lines = ["# timestamp tx ty tz qx qy qz qw", *(" ".join(map(repr, row)) for row in table.tolist())]
    with told_as(LogError, path):
        write_whole(path, "\n".join(lines) + "\n")


def write_bop(
    path: str | os.PathLike[str],
    poses: Poses,
    camera: Camera,
    kind: Kind = "filtered",
    *,
    scene_id: int = 1,
    object_id: int = 1,
) -> None:
    """Write results as the BOP challenge wants them for one camera, whole or not at all.

    The transform is from the model to the camera, R row by row, t in mm; `im_id` is the frame's number,
    the score its confidence, the time -1 (unknown). Scene and object have the numbers that data sets of
    `python -m synthetic dataset --bop` give them.

    Args:
        path: the file; the challenge wants METHOD_DATASET-test.csv.
        poses: what to write.
        camera: the one whose images they are results for.
        kind: which poses.
        scene_id: number of the scene.
        object_id: number of the object's model.

    Raises:
        LogError: the recording has no poses of that kind, one has no confidence, or the file cannot be
            written.
    """
    columns = poses.columns(kind)
    found = columns.take(columns.has_pose)
    if np.isnan(found.confidence).any():
        raise LogError(
            f"{os.fspath(path)}: found {kind} poses without a confidence, expected a score for each"
        )
    rotation, translation = camera_from_object(found, camera)
    rows = (
        [scene_id, image_id, object_id, score, _spaced(r), _spaced(_MM * t), -1]
        for image_id, score, r, t in zip(
            poses.index[columns.has_pose].tolist(),
            found.confidence.tolist(),
            rotation,
            translation,
            strict=True,
        )
    )
    with told_as(LogError, path):
        write_whole(path, _table(BOP_HEADER, rows))


def columns_of(poses: Poses) -> dict[str, Array]:
    """(n,) columns under CSV_HEADER: numbers with NaN where there is none, and texts."""
    numbers = numbers_of(poses)
    heads: list[Array] = [poses.index, poses.timestamp, poses.status]
    tail: Array = np.array(camera_cells(poses), dtype=np.str_)
    arrays = [*heads, *numbers.T, tail]
    return dict(zip(CSV_HEADER, arrays, strict=True))


def to_dataframe(poses: Poses) -> Any:
    """A pandas DataFrame with the columns of the CSV file; the index is the frame's number.

    Raises:
        TrackerError: the package pandas is missing.
    """
    frame: Any = _package("pandas").DataFrame(columns_of(poses))
    return frame.set_index("frame")


def to_xarray(poses: Poses) -> Any:
    """An xarray Dataset along `frame`, with whole vectors and covariances, e.g. `filtered_position`.

    Raises:
        TrackerError: the package xarray is missing.
    """
    names = {3: "axis", 4: "xyzw", 6: "twist"}
    variables: dict[str, Any] = {"timestamp": ("frame", poses.timestamp), "status": ("frame", poses.status)}
    if poses.cameras is not None:
        variables["cameras"] = (("frame", "camera"), poses.cameras)
    for kind in ("measured", "filtered", "recorded"):
        columns = getattr(poses, kind)
        for name, array in columns.arrays().items() if columns is not None else ():
            sizes = array.shape[1:]
            axes = [names[size] + ("_too" if k else "") for k, size in enumerate(sizes)]
            variables[f"{kind}_{name}"] = (("frame", *axes), array)
    coordinates = {
        "frame": poses.index,
        "axis": list("xyz"),
        "xyzw": list("xyzw"),
        "camera": list(poses.about.rig.names),
    }
    about = {name: getattr(poses.about, name) for name in ("object_name", "source", "tracker_version")}
    return _package("xarray").Dataset(variables, coords=coordinates, attrs=about)


def write_parquet(path: str | os.PathLike[str], poses: Poses) -> None:
    """Write the columns of the CSV file as Parquet, whole or not at all; NaN becomes null.

    Raises:
        LogError: the file cannot be written.
        TrackerError: the package pyarrow is missing.
    """
    pa, pq = _package("pyarrow"), _package("pyarrow.parquet")
    table = pa.table({name: pa.array(column, from_pandas=True) for name, column in columns_of(poses).items()})
    with told_as(LogError, path), whole_file(path) as temporary:
        pq.write_table(table, temporary, compression="zstd")


def camera_from_object(columns: PoseColumns, camera: Camera) -> tuple[FloatArray, FloatArray]:
    """Rotations (n, 3, 3) and translations (n, 3) [m] from the object's frame to the camera's."""
    camera_from_world = camera.camera_from_world[:3, :3]
    rotation: FloatArray = camera_from_world @ so3.matrix_from_quaternion(columns.orientation)
    translation: FloatArray = columns.position @ camera_from_world.T + camera.camera_from_world[:3, 3]
    return rotation, translation


def numbers_of(poses: Poses) -> FloatArray:
    """(n, k) the columns of numbers under CSV_HEADER, after the status; NaN where there is none."""
    recorded = PoseColumns.nothing(len(poses)) if poses.recorded is None else poses.recorded
    return np.concatenate(
        [
            *_pose_and_std(poses.measured),
            *_pose_and_std(poses.filtered),
            poses.filtered.velocity,
            _std(poses.filtered.velocity_covariance),
            *_pose(recorded),
        ],
        axis=1,
    )


def camera_cells(poses: Poses) -> list[str]:
    """What became of each frame's pictures, as one text."""
    if poses.cameras is None:
        return [""] * len(poses)
    return [CAMERA_SEPARATOR.join(uses) if any(uses) else "" for uses in poses.cameras.tolist()]


def _pose(columns: PoseColumns) -> list[FloatArray]:
    return [columns.position, columns.orientation, columns.confidence[:, None]]


def _pose_and_std(columns: MeasuredColumns) -> list[FloatArray]:
    return [*_pose(columns), _std(columns.covariance)]


def _std(covariance: FloatArray) -> FloatArray:
    result: FloatArray = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    return result


def _spaced(values: Array) -> str:
    return " ".join(map(repr, values.ravel().tolist()))


def _table(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    return text.getvalue()


def _package(name: str) -> Any:
    try:
        return import_module(name)
    except ImportError as error:
        package = name.partition(".")[0]
        raise TrackerError(f"this needs the package {package}: pip install {package}") from error
