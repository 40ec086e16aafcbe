"""One line about a recording in the table over all of them."""

from __future__ import annotations

from typing import Any

import numpy as np

from tracker.conventions import FloatArray
from tracker.pose.result import CameraUse
from tracker.poses.columns import FilteredColumns
from tracker.poses.poses import Poses
from tracker.recordings.recipe import Job
from tracker.recordings.track import Tracked, unicode_text
from tracker.summaries.remarks import remark_on_recording
from tracker.summaries.rewards import goal_columns
from tracker.summaries.summary import best, summary

STEP = 0.002
"""Shortest movement [m] that counts in a path's length: less is how far poses of an object at rest differ."""

FAST = 99.0  # percentile of the speed that is reported: a single frame says little

COLUMNS: dict[str, type] = {
    "recording": str,
    "output": str,
    "object": str,
    "fault": str,
    "frames": int,
    "expected_frames": int,
    "seconds": float,
    "share_found": float,
    "share_filtered": float,
    "share_coasting": float,
    "share_lost": float,
    "confidence_median": float,
    "position_std_median_mm": float,
    "rotation_std_median_deg": float,
    "worst_camera": str,
    "worst_camera_contradicting": float,
    "swapped": str,
    "path_length_m": float,
    "height_max_m": float,
    "speed_p99_m_per_s": float,
    "recorded_position_median_mm": float,
    "recorded_position_p90_mm": float,
    "recorded_angle_median_deg": float,
    "recorded_angle_p90_deg": float,
    "task": str,
    "level": int,
    "reward_total": float,
    "reward_mean": float,
    "error_end": float,
    "goal_fault": str,
}
"""Columns of the table; docs/batch.md says what each of them is."""


def row(job: Job, tracked: Tracked) -> dict[str, Any]:
    """The line about a recording, under COLUMNS; None where there is nothing to tell."""
    poses, numbers = tracked.poses, summary(tracked)
    found: dict[str, Any] = {
        "recording": unicode_text(str(job.log)),
        "output": unicode_text(job.output.name),
        "object": poses.about.object_name,
        "fault": poses.about.fault or None,
        "frames": len(poses),
        "expected_frames": tracked.expected,
    }
    if len(poses):
        shares = {f"share_{name}": float(np.mean(poses.status == name)) for name in ("coasting", "lost")}
        recorded = {f"recorded_{name}": value for name, value in (numbers["recorded"] or {}).items()}
        found |= {
            "seconds": float(poses.timestamp[-1] - poses.timestamp[0]),
            "share_found": numbers["measured"],
            "share_filtered": numbers["filtered"],
            "swapped": remark_on_recording(job, poses),
        }
        found |= {**shares, **recorded, **_worst(numbers["cameras"] or {}), **_sure_and_far(poses)}
        found |= goal_columns(job.log, poses, job.recipe.model)
    return {name: found.get(name) for name in COLUMNS}


def path_length(positions: FloatArray) -> float:
    """Length [m] of the way along positions (n, 3) [m], without steps shorter than STEP."""
    length, last = 0.0, positions[0]
    for position in positions[1:]:
        step = float(np.linalg.norm(position - last))
        if step > STEP:
            length, last = length + step, position
    return length


def _worst(cameras: dict[str, dict[str, float | None]]) -> dict[str, Any]:
    """The camera that contradicts the others most, and in which share of the frames with a measured pose."""
    shares = {name: its[CameraUse.CONTRADICTING.value] for name, its in cameras.items()}
    known = {name: share for name, share in shares.items() if share is not None}
    if not known:
        return {}
    worst = max(known, key=known.__getitem__)
    return {"worst_camera": worst if known[worst] else None, "worst_camera_contradicting": known[worst]}


def _sure_and_far(poses: Poses) -> dict[str, float]:
    """How sure the poses are, and where and how quickly the object went."""
    some = best(poses).take(best(poses).has_pose)
    if not len(some):
        return {}
    std = np.sqrt(np.diagonal(some.covariance, axis1=1, axis2=2))
    found = {
        "confidence_median": float(np.median(some.confidence)),
        "position_std_median_mm": 1e3 * float(np.median(std[:, :3].max(axis=1))),
        "rotation_std_median_deg": float(np.degrees(np.median(std[:, 3:].max(axis=1)))),
        "path_length_m": path_length(some.position),
        "height_max_m": float(some.position[:, 2].max()),
    }
    if isinstance(some, FilteredColumns):
        found["speed_p99_m_per_s"] = float(np.percentile(np.linalg.norm(some.velocity[:, :3], axis=1), FAST))
    return found
