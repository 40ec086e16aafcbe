"""Collects the answers to a recording's frames, one by one."""

from __future__ import annotations

from typing import Any

import numpy as np

from tracker.checks import float_array
from tracker.conventions import Array
from tracker.errors import LogError
from tracker.pose.result import Observation
from tracker.poses.columns import FilteredColumns, MeasuredColumns, PoseColumns
from tracker.poses.poses import KINDS, About, Kind, Poses
from tracker.stamps import one_stamp


class PosesBuilder:
    """Grows by one frame at a time; `build` gives what there is, and can be called again later.

    Args:
        about: what the poses are made from.
    """

    def __init__(self, about: About) -> None:
        self._about = about
        self._index: list[int] = []
        self._timestamp: list[float] = []
        self._status: list[str] = []
        self._cameras: list[list[str]] = []
        self._rows: dict[Kind, list[dict[str, Array] | None]] = {kind: [] for kind in KINDS}

    def __len__(self) -> int:
        return len(self._index)

    def append(self, index: int, timestamp: float, answer: Observation, recorded: Any = None) -> None:
        """Add a frame.

        Args:
            index: the frame's number in the recording.
            timestamp: the frame's time [s].
            answer: the tracker's.
            recorded: the recording's own pose, with position, orientation and perhaps confidence, or None,
                as `LogFrame` gives it; what it says has been judged there.

        Raises:
            LogError: the time is none in seconds; a pose lacks something, or has it in another shape; or
                the answer is not about as many cameras as there are.
        """
        stamp = one_stamp(timestamp, f"frame {index}: timestamp", LogError)
        cameras = self._uses(answer)
        rows: dict[Kind, dict[str, Array] | None] = {
            "measured": _row("measured", answer.object_pose, MeasuredColumns),
            "filtered": _row("filtered", answer.filtered_object_pose, FilteredColumns),
            "recorded": _row("recorded", recorded, PoseColumns),
        }
        self._index.append(int(index))
        self._timestamp.append(stamp)
        self._status.append(_text(answer.status))
        self._cameras.append(cameras)
        for kind, row in rows.items():
            self._rows[kind].append(row)

    def build(self) -> Poses:
        """All frames so far.

        Raises:
            LogError: a pose or the order of the frames is not valid.
        """
        has_recorded = any(row is not None for row in self._rows["recorded"])
        return Poses(
            index=np.array(self._index, dtype=np.int64),
            timestamp=np.array(self._timestamp, dtype=np.float64),
            status=np.array(self._status, dtype=np.str_),
            measured=MeasuredColumns(**self._arrays("measured")),
            filtered=FilteredColumns(**self._arrays("filtered")),
            recorded=PoseColumns(**self._arrays("recorded")) if has_recorded else None,
            about=self._about,
            cameras=self._camera_column() if any(any(uses) for uses in self._cameras) else None,
        )

    def _uses(self, answer: Observation) -> list[str]:
        """What became of each camera's picture."""
        rig, uses = self._about.rig, [_text(use) for use in answer.cameras]
        if uses and len(uses) != len(rig):
            raise LogError(f"cameras: found {len(uses)}, expected {len(rig)}: {', '.join(rig.names)}")
        return uses or [""] * len(rig)

    def _camera_column(self) -> Array:
        return np.array(self._cameras, dtype=np.str_).reshape(len(self), len(self._about.rig))

    def _arrays(self, kind: Kind) -> dict[str, Array]:
        rows = self._rows[kind]
        arrays: dict[str, Array] = {"has_pose": np.array([row is not None for row in rows], dtype=np.bool_)}
        for name, shape in KINDS[kind].ROW_SHAPES.items():
            column = np.full((len(rows), *shape), np.nan)
            for number, row in enumerate(rows):
                if row is not None:
                    column[number] = row[name]
            arrays[name] = column
        return arrays


def _text(word: Any) -> str:
    """The value of an enum, or the text itself."""
    return str(getattr(word, "value", word))


def _row(kind: Kind, pose: Any, columns: type[PoseColumns]) -> dict[str, Array] | None:
    """Copies of what a pose has to say, by the column's name."""
    if pose is None:
        return None
    row: dict[str, Array] = {}
    for name, shape in columns.ROW_SHAPES.items():
        value = getattr(pose, name, None)
        if value is None and name in columns.MAY_BE_UNKNOWN:
            value = np.full(shape, np.nan)
        if value is None:  # which NumPy would take for NaN
            raise LogError(f"{kind} pose: {name}: found none, expected numbers of shape {shape}")
        row[name] = float_array(value, shape, f"{kind} pose: {name}", LogError, finite=False)
    return row
