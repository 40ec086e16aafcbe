"""What came out of a recording, in plain numbers."""

from __future__ import annotations

from typing import Any

import numpy as np

from tracker.logs.comparison import compare
from tracker.logs.poses import Kind, Poses
from tracker.recordings.track import Tracked


def best_kind(poses: Poses) -> Kind:
    """The filtered poses, or the measured ones where nothing was filtered."""
    return "filtered" if poses.filtered.has_pose.any() else "measured"


def summary(tracked: Tracked) -> dict[str, Any]:
    """Numbers for people and programs; None where there is nothing to count.

    Returns:
        `frames`; `measured` and `filtered`, the shares of frames with such a pose; `statuses`, the share
        of each status and, in `with_pose`, how many of its frames have a pose; medians over the frames of
        the standard deviations along x, y, z of the poses named by `kind`; `frames_per_second`;
        `recorded`, see `compare`, of the same poses; `fault`.
    """
    poses = tracked.poses
    count, kind = len(poses), best_kind(poses)
    columns = poses.filtered if kind == "filtered" else poses.measured
    variance = np.diagonal(columns.covariance[columns.has_pose], axis1=1, axis2=2)
    std = np.median(np.sqrt(variance), axis=0) if len(variance) else None
    rate = tracked.new / tracked.seconds if tracked.new and tracked.seconds > 0 else None
    return {
        "frames": count,
        "measured": float(np.mean(poses.measured.has_pose)) if count else None,
        "filtered": float(np.mean(poses.filtered.has_pose)) if count else None,
        "statuses": {str(name): _status(poses, str(name)) for name in np.unique(poses.status)},
        "kind": kind,
        "position_std_median_mm": None if std is None else (1e3 * std[:3]).tolist(),
        "rotation_std_median_deg": None if std is None else np.degrees(std[3:]).tolist(),
        "frames_per_second": rate,
        "recorded": None if poses.recorded is None else compare(poses, kind),
        "fault": tracked.fault,
    }


def _status(poses: Poses, name: str) -> dict[str, float]:
    its = poses.status == name
    has_pose = poses.measured.has_pose | poses.filtered.has_pose
    return {"share": float(np.mean(its)), "with_pose": float(np.mean(has_pose[its]))}
