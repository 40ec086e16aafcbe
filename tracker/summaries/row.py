"""One line about a recording in the table over all of them."""

from __future__ import annotations

from typing import Any

import numpy as np

from tracker.conventions import FloatArray
from tracker.pose.result import CameraUse
from tracker.poses.poses import Poses, compare
from tracker.recordings.recipe import Job
from tracker.recordings.track import Tracked, unicode_text
from tracker.summaries.rewards import goal_columns
from tracker.summaries.summary import best_kind
from tracker.summaries.swapped import told_of_recording

STEP = 0.002
"""Shortest movement [m] that counts in a path's length: less is how far poses of an object at rest differ."""

FAST = 99.0
"""Percentile of the speed that is told: a single frame says little."""

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
    poses = tracked.poses
    found: dict[str, Any] = {
        "recording": unicode_text(str(job.log)),
        "output": unicode_text(job.output.name),
        "object": poses.about.object_name,
        "fault": poses.about.fault or None,
        "frames": len(poses),
        "expected_frames": tracked.expected,
    }
    if len(poses):
        found |= {**_shares(poses), **_sure(poses), **_worst(poses), **_motion(poses), **_recorded(poses)}
        found |= {"swapped": told_of_recording(job, poses), **goal_columns(job.log, poses, job.recipe.model)}
    return {name: found.get(name) for name in COLUMNS}


def path_length(positions: FloatArray) -> float:
    """Length [m] of the way along positions (n, 3) [m], without steps shorter than STEP."""
    length, last = 0.0, positions[0]
    for position in positions[1:]:
        step = float(np.linalg.norm(position - last))
        if step > STEP:
            length, last = length + step, position
    return length


def _shares(poses: Poses) -> dict[str, float]:
    return {
        "seconds": float(poses.timestamp[-1] - poses.timestamp[0]),
        "share_found": float(np.mean(poses.measured.has_pose)),
        "share_filtered": float(np.mean(poses.filtered.has_pose)),
        "share_coasting": float(np.mean(poses.status == "coasting")),
        "share_lost": float(np.mean(poses.status == "lost")),
    }


def _sure(poses: Poses) -> dict[str, float]:
    columns = poses.filtered if best_kind(poses) == "filtered" else poses.measured
    if not columns.has_pose.any():
        return {}
    some = columns.take(columns.has_pose)
    std = np.sqrt(np.diagonal(some.covariance, axis1=1, axis2=2))
    return {
        "confidence_median": float(np.median(some.confidence)),
        "position_std_median_mm": 1e3 * float(np.median(std[:, :3].max(axis=1))),
        "rotation_std_median_deg": float(np.degrees(np.median(std[:, 3:].max(axis=1)))),
    }


def _worst(poses: Poses) -> dict[str, Any]:
    """The camera that contradicts the others most, and in which share of the frames with a measured pose."""
    if poses.cameras is None or not poses.measured.has_pose.any():
        return {}
    shares = np.mean(poses.cameras[poses.measured.has_pose] == CameraUse.CONTRADICTING.value, axis=0)
    worst = int(np.argmax(shares))
    name = poses.about.rig.names[worst] if shares[worst] else None
    return {"worst_camera": name, "worst_camera_contradicting": float(shares[worst])}


def _motion(poses: Poses) -> dict[str, float]:
    columns = poses.columns(best_kind(poses))
    positions = columns.position[columns.has_pose]
    if not len(positions):
        return {}
    found = {"path_length_m": path_length(positions), "height_max_m": float(positions[:, 2].max())}
    if poses.filtered.has_pose.any():
        speed = np.linalg.norm(poses.filtered.velocity[poses.filtered.has_pose, :3], axis=1)
        found["speed_p99_m_per_s"] = float(np.percentile(speed, FAST))
    return found


def _recorded(poses: Poses) -> dict[str, float | None]:
    if poses.recorded is None:
        return {}
    numbers = compare(poses, best_kind(poses))
    return {f"recorded_{name}": numbers[name] for name in numbers if name.startswith(("position", "angle"))}
