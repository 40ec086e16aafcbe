"""What a run of the benchmarks leaves: one record for each frame, and the file that holds everything."""

from __future__ import annotations

import dataclasses
import json
import math
import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tracker.conventions import Array
from tracker.errors import TrackerError
from tracker.files import write_whole

Results = dict[str, Any]
"""Plain numbers, texts, lists and dictionaries:

    about         commit, processor, seed, scenes, quick, ...
    frames        the records as dictionaries, in order
    summary       {workload: {object: {metric: value}}}
    targets       [{name, object, target, value, met, unit}]
    speed, recorded, segmentation    where measured
"""

RESULTS_FILE = "results.json"


class ResultsError(TrackerError):
    """A file of results that is missing or cannot be read."""


@dataclasses.dataclass(frozen=True)
class FrameRecord:
    """What the tracker answered to one frame of a workload. Numbers are nan where there is none."""

    workload: str
    """Name of the workload, see `benchmarks.data.workloads`."""
    object: str
    """Name of the object."""
    index: int
    """Number of the frame in its set of scenes."""
    cameras: int
    """Number of cameras that gave an image."""
    visible_fraction: float
    """Mean over these cameras of the visible share of the object's pixels [1]."""
    present: bool
    """Whether there is an object."""
    status: str
    """`Status.value` of the answer."""
    found: bool
    """Whether the answer holds a pose."""
    position_mm: float = math.nan
    """Distance of the positions [mm]."""
    rotation_deg: float = math.nan
    """Angle of the rotation between the two [°]."""
    axis_deg: float = math.nan
    """Angle between the object's longest axes [°]; of cuboids with one longest axis."""
    roll_deg: float = math.nan
    """Angle about the longest axis [°]; of the same."""
    add_mm: float = math.nan
    """Mean distance of the surface's points [mm]."""
    mssd_mm: float = math.nan
    """Greatest distance of the surface's points [mm]."""
    mspd_px: float = math.nan
    """Greatest distance of the projected corners, in the worst of the cameras [px]."""
    nees: float = math.nan
    """dᵀ Σ⁻¹ d of the pose's error d and its stated covariance Σ [1]."""
    confidence: float = math.nan
    """Stated probability of being within 5 mm and 5° [1]."""
    bound_mm: float = math.nan
    """Cramér-Rao bound: square root of the trace of the position's covariance [mm]."""
    bound_deg: float = math.nan
    """The same of the rotation [°]."""
    bound_fixed_mm: float = math.nan
    """As `bound_mm`, with an edge noise of 0.3 px whatever the image [mm]."""
    bound_fixed_deg: float = math.nan
    """As `bound_deg`, with an edge noise of 0.3 px whatever the image [°]."""
    task_position_error: float = math.nan
    """The tasks' position error between true and estimated pose [1]."""
    task_rotation_error: float = math.nan
    """The tasks' rotation error, of cuboids with one longest axis that of the axis alone [1]."""
    milliseconds: float = math.nan
    """Time of the detection [ms]."""


_FLOATS = tuple(f.name for f in dataclasses.fields(FrameRecord) if f.type == "float")


def records_of(results: Results) -> list[FrameRecord]:
    """The frames of a run; fields that the file does not know are left at their defaults."""
    known = {field.name for field in dataclasses.fields(FrameRecord)}
    return [FrameRecord(**{k: v for k, v in row.items() if k in known}) for row in results["frames"]]


def column(records: Sequence[FrameRecord], key: str) -> Array:
    """(N,) one field of all records."""
    kind = float if key in _FLOATS else None
    return np.array([getattr(record, key) for record in records], dtype=kind)


def select(records: Iterable[FrameRecord], workload: str, name: str | None = None) -> list[FrameRecord]:
    """The records of one workload, and of one object if named."""
    return [r for r in records if r.workload == workload and name in (None, r.object)]


def write_results(path: str | os.PathLike[str], results: Results) -> None:
    """Write results as JSON, with null for nan; infinite numbers become null as well."""
    plain = _plain(results)
    frames = plain.pop("frames", [])
    # One line a frame: a file that can be read, and compared, by eye.
    rows = ",\n".join(json.dumps(row, ensure_ascii=False) for row in frames)
    head = json.dumps(plain, indent=1, ensure_ascii=False)
    text = f'{head[:-2]},\n "frames": [\n{rows}\n ]\n}}\n' if plain else f'{{"frames": [\n{rows}\n]}}\n'
    write_whole(path, text)


def read_results(path: str | os.PathLike[str]) -> Results:
    """Read what `write_results` wrote; null becomes nan again, but not in targets and speed.

    Args:
        path: the file, or the folder that holds it.

    Raises:
        ResultsError: there is no such file, or it holds something else.
    """
    file = Path(path)
    if file.is_dir():
        file = file / RESULTS_FILE
    try:
        results = json.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise ResultsError(f"{file}: {error.strerror or error}") from error
    except ValueError as error:
        raise ResultsError(f"{file}: not a file of results: {error}") from error
    if not isinstance(results, dict) or not isinstance(results.get("frames"), list):
        raise ResultsError(f"{file}: found no list of frames, expected a file of results")
    for row in results["frames"]:
        for key in _FLOATS:
            if row.get(key, 0.0) is None:
                row[key] = math.nan
    for part in ("summary", "recorded", "segmentation"):
        if part in results:
            results[part] = _with_nan(results[part])
    return results


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float):
        # Seven digits are more than any of this is worth, and keep the file short.
        return float(f"{value:.7g}") if math.isfinite(value) else None
    return value


def _with_nan(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _with_nan(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_with_nan(item) for item in value]
    return math.nan if value is None else value
