"""How the poses that were found differ from those that the recording brings along."""

from __future__ import annotations

import numpy as np

from tracker.conventions import Array
from tracker.geometry import so3
from tracker.poses.poses import Kind, Poses


def compare(poses: Poses, kind: Kind = "filtered") -> dict[str, float | None]:
    """Differences to the recorded poses, in plain numbers.

    Args:
        poses: of a recording that has poses.
        kind: which poses are compared with the recorded ones.

    Returns:
        `frames`: how many; `position_median_mm`, `position_p90_mm`, `angle_median_deg`, `angle_p90_deg` over
        the frames where both have a pose, None where there is no such frame; and the shares of all frames
        `share_both`, `share_only_found`, `share_only_recorded`, `share_neither`, None without any frame.

    Raises:
        LogError: the recording has no poses, or there is no such kind.
    """
    found, recorded = poses.columns(kind), poses.columns("recorded")
    both = found.has_pose & recorded.has_pose
    ours, theirs = found.take(both), recorded.take(both)
    distance = 1e3 * np.linalg.norm(ours.position - theirs.position, axis=1)
    angle = np.degrees(
        so3.angle_between(
            so3.matrix_from_quaternion(ours.orientation), so3.matrix_from_quaternion(theirs.orientation)
        )
    )
    return {
        "frames": float(len(poses)),
        "position_median_mm": _quantile(distance, 0.5),
        "position_p90_mm": _quantile(distance, 0.9),
        "angle_median_deg": _quantile(angle, 0.5),
        "angle_p90_deg": _quantile(angle, 0.9),
        "share_both": _share(both),
        "share_only_found": _share(found.has_pose & ~recorded.has_pose),
        "share_only_recorded": _share(~found.has_pose & recorded.has_pose),
        "share_neither": _share(~found.has_pose & ~recorded.has_pose),
    }


def _quantile(values: Array, share: float) -> float | None:
    return float(np.quantile(values, share)) if len(values) else None


def _share(chosen: Array) -> float | None:
    return float(np.mean(chosen)) if len(chosen) else None
