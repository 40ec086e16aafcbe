"""Exports poses to other formats: CSV, Parquet, TUM trajectories, BOP results."""

import os
from collections.abc import Mapping

import numpy as np

from tracker.checks import of_kind, optional
from tracker.conventions import Array, FloatArray
from tracker.errors import LogError
from tracker.files import csv_text, parquet_file, write_whole, writing
from tracker.geometry.camera import Camera
from tracker.objects.model import CuboidModel
from tracker.poses.columns import PoseColumns
from tracker.poses.poses import Kind, Poses

BOP_HEADER = ("scene_id", "im_id", "obj_id", "score", "R", "t", "time")
"""Header of a file of BOP results."""


def write_csv(
    path: str | os.PathLike[str],
    poses: Poses,
    *,
    keypoints_of: CuboidModel | None = None,
    more: Mapping[str, Array] | None = None,
) -> None:
    """Write one row per frame of the `poses.table`, whole or not at all; missing values give empty cells.

    keypoints_of: an object whose corners to add as columns. more: further columns (n,) by name, such as those
    of `tracker.logs.RobotState`.

    Numbers are written so that reading them back gives the same bits. Standard deviations are square roots of
    the covariance's diagonal.

    Raises:
        LogError: the file cannot be written, or a column of `more` replaces another or has another length.
    """
    table = _table(poses, keypoints_of, more)
    rows = (
        ["" if value != value else value for value in row]  # only NaN differs from itself
        for row in zip(*(column.tolist() for column in table.values()), strict=True)
    )
    with writing(LogError, path):
        write_whole(path, csv_text(tuple(table), rows))


def write_tum(path: str | os.PathLike[str], poses: Poses, kind: Kind = "filtered") -> None:
    """Write a trajectory in the format of the TUM RGB-D benchmark, whole or not at all.

    A line is `timestamp tx ty tz qx qy qz qw` [s, m], the object in the world; frames without a pose have no
    line. LogError: the recording has no poses of that `kind`, or the file cannot be written.
    """
    columns = _poses(poses).columns(kind)
    table = np.column_stack([poses.timestamp, columns.position, columns.orientation])[columns.has_pose]
    lines = ["# timestamp tx ty tz qx qy qz qw", *(" ".join(map(repr, row)) for row in table.tolist())]
    with writing(LogError, path):
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
    """Write results in the format of the BOP challenge for one camera, whole or not at all.

    The transform is from the model to the camera, R in row-major order, t in mm; `im_id` is the frame's
    number, the score its confidence, the time -1 (unknown). By default, scene and object have the same
    numbers as in data sets of `python -m synthetic dataset --bop`.

    Args:
        path: the file; the challenge expects the name METHOD_DATASET-test.csv.
        poses: the poses to write.
        camera: the camera whose images the results are for.
        kind: which poses to write.
        scene_id: number of the scene.
        object_id: number of the object's model.

    Raises:
        LogError: the recording has no such poses, a pose has no confidence, or the file cannot be written.
    """
    of_kind(camera, Camera, "camera", LogError)
    columns = _poses(poses).columns(kind)
    found = columns[columns.has_pose]
    if np.isnan(found.confidence).any():
        what = f"found {kind} poses without a confidence"
        raise LogError(f"{os.fspath(path)}: {what}, expected a score for each")
    rotation, translation = camera_from_object(found, camera)
    images, scores = poses.index[columns.has_pose].tolist(), found.confidence.tolist()
    rows = (
        [scene_id, image, object_id, score, _spaced(r), _spaced(1000.0 * t), -1]
        for image, score, r, t in zip(images, scores, rotation, translation, strict=True)
    )
    with writing(LogError, path):
        write_whole(path, csv_text(BOP_HEADER, rows))


def write_parquet(
    path: str | os.PathLike[str],
    poses: Poses,
    *,
    keypoints_of: CuboidModel | None = None,
    more: Mapping[str, Array] | None = None,
) -> None:
    """Write the columns of the CSV file as Parquet, whole or not at all; NaN becomes null.

    Arguments and errors are those of `write_csv`; TrackerError: the package pyarrow is missing.
    """
    columns = _table(poses, keypoints_of, more)
    pa = optional("pyarrow", None, "this")
    table = pa.table({name: pa.array(column, from_pandas=True) for name, column in columns.items()})
    with writing(LogError, path), parquet_file(path) as add:
        add(table)


def camera_from_object(columns: PoseColumns, camera: Camera) -> tuple[FloatArray, FloatArray]:
    """Return rotations (n, 3, 3) and translations (n, 3) [m] from the object's to the camera's frame."""
    turn, shift = camera.camera_from_world[:3, :3], camera.camera_from_world[:3, 3]
    return turn @ columns.rotation, columns.position @ turn.T + shift


def _poses(poses: object) -> Poses:
    return of_kind(poses, Poses, "poses", LogError, "tracker.read_poses or tracker.track(...).poses")


def _table(
    poses: Poses, keypoints_of: CuboidModel | None, more: Mapping[str, Array] | None
) -> dict[str, Array]:
    """Return the columns of a table; LogError if one of `more` has a wrong length, or replaces another."""
    table = _poses(poses).table(keypoints_of)
    for name, column in (more or {}).items():
        if name in table or np.shape(column) != (len(poses),):
            found = f"found shape {np.shape(column)}, expected a new name and shape ({len(poses)},)"
            raise LogError(f"column {name}: {found}")
        table[name] = np.asarray(column)
    return table


def _spaced(values: Array) -> str:
    return " ".join(map(repr, values.ravel().tolist()))
