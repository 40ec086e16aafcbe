"""What cameras were set to, kept with an HDF5 log: of each the text of a JSON object, as bytes.

    camera_info/NAME/settings   (n,) uint8

Bytes rather than a text, since the library does not survive damaged texts.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence

import h5py
import numpy as np

from tracker.errors import LogError
from tracker.files.hdf5 import faults_as_log_errors, find
from tracker.logs.source import Settings

LARGEST = 1 << 16
"""Of one camera [bytes]."""


def write_settings(file: h5py.File, names: Sequence[str], settings: Sequence[Settings]) -> None:
    """Keep what is known of each camera; of one of which nothing is known there is no field."""
    for name, values in zip(names, settings or [{}] * len(names), strict=True):
        known = {key: value for key, value in values.items() if _is_told(value)}
        if known:
            content = json.dumps(known, allow_nan=False).encode()
            file[f"camera_info/{name}/settings"] = np.frombuffer(content, np.uint8)


def read_settings(file: h5py.File, names: Sequence[str], where: str) -> dict[str, Settings]:
    """What is known of each camera by its name, of those of which something is.

    Raises:
        LogError: a field is not what this project writes.
    """
    return {name: values for name in names if (values := _of_camera(file, name, where)) is not None}


def _is_told(value: str | int | float | bool) -> bool:
    return not isinstance(value, float) or math.isfinite(value)


def _refuse(constant: str) -> float:
    raise ValueError(f"found {constant}, expected a finite number")


def _of_camera(file: h5py.File, name: str, where: str) -> Settings | None:
    path = f"camera_info/{name}/settings"
    field, what = find(file, path, f"{where}: "), f"{where}: {path}"
    if field is None:
        return None
    if field.dtype != np.uint8 or field.ndim != 1 or field.size > LARGEST:
        raise LogError(f"{what}: found {field.dtype} of shape {field.shape}, expected up to {LARGEST} bytes")
    with faults_as_log_errors(what):
        values = json.loads(field[:].tobytes(), parse_constant=_refuse)
    plain = isinstance(values, dict) and all(
        isinstance(value, (str, int, float, bool)) for value in values.values()
    )
    if not plain:
        raise LogError(f"{what}: found other than names with texts or numbers, expected a camera's settings")
    settings: Settings = values
    return settings
