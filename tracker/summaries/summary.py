"""Summary of a tracked recording in plain numbers."""

from __future__ import annotations

from typing import Any

import numpy as np

from tracker.conventions import Array
from tracker.pose.result import CameraUse
from tracker.poses.columns import MeasuredColumns
from tracker.poses.poses import Kind, Poses, compare
from tracker.recordings.track import Tracked

TOLERABLE = {
    CameraUse.CONTRADICTING: 0.1,
    CameraUse.NO_IMAGE: 0.01,
    CameraUse.FROZEN: 0.01,
    CameraUse.BLACK: 0.01,
}
"""Largest share of frames in which a camera's image may be unused without causing a remark, by reason:
fingers and motion blur make some images contradict the others."""


def best_kind(poses: Poses) -> Kind:
    """Return the kind of poses to summarise: filtered if there are any, else measured."""
    return "filtered" if poses.filtered.has_pose.any() else "measured"


def best(poses: Poses) -> MeasuredColumns:
    """Return the poses of the `best_kind`."""
    return poses.filtered if best_kind(poses) == "filtered" else poses.measured


def to_look_at(cameras: dict[str, dict[str, float | None]]) -> dict[str, dict[CameraUse, float]]:
    """Return the shares in `summary`'s `cameras` that exceed TOLERABLE, without cameras that have none."""
    found = {
        name: {use: share for use, least in TOLERABLE.items() if (share := shares[use.value] or 0.0) > least}
        for name, shares in cameras.items()
    }
    return {name: shares for name, shares in found.items() if shares}


def camera_shares(poses: Poses) -> dict[str, dict[str, float | None]] | None:
    """Return `summary`'s `cameras`; None if it is unknown how the cameras' images were used."""
    if poses.cameras is None:
        return None
    return {
        name: {use.value: _share(its, use, poses.measured.has_pose) for use in TOLERABLE}
        for name, its in zip(poses.about.rig.names, poses.cameras.T, strict=True)
    }


def summary(tracked: Tracked) -> dict[str, Any]:
    """Summarise a tracked recording; values are None if there is nothing to count.

    Returns:
        `frames`, of which `new` were tracked now; `expected`, how many the recording should have;
        `last_frame`, the number of the last one; `measured` and `filtered`, the shares of frames with such a
        pose; `statuses`, each status's share of frames and, as `with_pose`, the share of these with a pose;
        `cameras`, for each camera the shares of frames in which its image was not used, by `CameraUse` (for
        contradicting ones, of the frames with a measured pose); medians over the frames of the standard
        deviations along x, y, z of the poses named by `kind`; `frames_per_second`; `recorded`, the result
        of `compare` for the same poses; `fault`.
    """
    poses = tracked.poses
    count, kind = len(poses), best_kind(poses)
    columns = best(poses)
    variance = np.diagonal(columns.covariance[columns.has_pose], axis1=1, axis2=2)
    std = np.median(np.sqrt(variance), axis=0) if len(variance) else None
    rate = tracked.new / tracked.seconds if tracked.new and tracked.seconds > 0 else None
    return {
        "frames": count,
        "expected": tracked.expected,
        "new": tracked.new,
        "last_frame": int(poses.index[-1]) if count else None,
        "measured": float(np.mean(poses.measured.has_pose)) if count else None,
        "filtered": float(np.mean(poses.filtered.has_pose)) if count else None,
        "statuses": {str(name): _status(poses, str(name)) for name in np.unique(poses.status)},
        "cameras": camera_shares(poses),
        "kind": kind,
        "position_std_median_mm": None if std is None else (1e3 * std[:3]).tolist(),
        "rotation_std_median_deg": None if std is None else np.degrees(std[3:]).tolist(),
        "frames_per_second": rate,
        "recorded": None if poses.recorded is None else compare(poses, kind),
        "fault": tracked.fault,
    }


def _share(uses: Array, use: CameraUse, has_pose: Array) -> float | None:
    counted = uses != ""
    if use is CameraUse.CONTRADICTING:
        counted &= has_pose
    return float(np.mean(uses[counted] == use.value)) if counted.any() else None


def _status(poses: Poses, name: str) -> dict[str, float]:
    its = poses.status == name
    has_pose = poses.measured.has_pose | poses.filtered.has_pose
    return {"share": float(np.mean(its)), "with_pose": float(np.mean(has_pose[its]))}
