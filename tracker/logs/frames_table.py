"""Poses as a table: one row a frame, the columns of the CSV file, for pandas, xarray and Parquet."""

from __future__ import annotations

import os
from importlib import import_module
from typing import Any

import numpy as np

from tracker.conventions import Array
from tracker.errors import LogError, TrackerError
from tracker.files import whole_file
from tracker.logs.exports import CSV_HEADER, camera_cells, numbers_of
from tracker.logs.poses import Poses


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
    try:
        with whole_file(path) as temporary:
            pq.write_table(table, temporary, compression="zstd")
    except (OSError, ValueError) as error:
        raise LogError(f"{os.fspath(path)}: cannot be written: {error}") from error


def _package(name: str) -> Any:
    try:
        return import_module(name)
    except ImportError as error:
        package = name.partition(".")[0]
        raise TrackerError(f"this needs the package {package}: pip install {package}") from error
