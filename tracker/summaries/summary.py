"""A tracked recording in numbers: its summary, its rewards for the goal in its folder, its row in a table."""

from pathlib import Path
from typing import Any

import numpy as np

from tracker.conventions import Array, FloatArray
from tracker.errors import LogError, TaskError, reason
from tracker.logs import Log, open_log
from tracker.objects.model import CuboidModel
from tracker.pose.result import CameraUse
from tracker.poses.columns import FilteredColumns, MeasuredColumns
from tracker.poses.poses import Kind, Poses, compare
from tracker.recordings.track import Job, Tracked, unicode_text
from tracker.tasks.job_goal import FILE_NAME, STEPS_PER_SECOND, JobGoal, read_job_goal

SURE = 0.9
"""Confidence at and above which a pose may be acted on."""

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
        `frames`, of which `new` were tracked now; `expected`, how many the file holds;
        `last_frame`, the number of the last one; `measured` and `filtered`, the shares of frames with such a
        pose; `statuses`, each status's share of frames and, as `with_pose`, the share of these with a pose;
        `cameras`, for each camera the shares of frames in which its image was not used, by `CameraUse` (for
        contradicting ones, of the frames with a measured pose); of the poses named by `kind`, the median
        confidence, the share that is `sure`, and medians of the standard deviations along x, y, z;
        `frames_per_second`; `recorded`, the result of `compare` for the same poses; `fault`.
    """
    poses, kind, columns = tracked.poses, best_kind(tracked.poses), best(tracked.poses)
    count = len(poses)
    variance = np.diagonal(columns.covariance[columns.has_pose], axis1=1, axis2=2)
    std = np.median(np.sqrt(variance), axis=0) if len(variance) else None
    confidence = columns.confidence[columns.has_pose]
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
        "confidence_median": float(np.median(confidence)) if len(variance) else None,
        "sure": float(np.mean(confidence >= SURE)) if len(variance) else None,
        "position_std_median_mm": None if std is None else (1e3 * std[:3]).tolist(),
        "rotation_std_median_deg": None if std is None else np.degrees(std[3:]).tolist(),
        "frames_per_second": rate,
        "recorded": None if poses.recorded is None else compare(columns, poses.recorded),
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


SAME = 1e-3  # largest difference between timestamps of the same frame [s]: formats round them


def refuse_others(path: Path, poses: Poses, recording: Path, log: Log) -> None:
    """Raise LogError if numbers and timestamps of first and last frame show poses of another recording."""
    if not len(poses):
        return
    # A frame whose images are all older than those before has a time of its own.
    advancing = np.flatnonzero(np.diff(poses.timestamp, prepend=-np.inf) >= SAME)
    for row in (0, advancing[-1]):
        number = int(poses.index[row])
        stamps = np.array([np.inf])
        if number < len(log):
            frame = log.frame(number)
            # A frame of a folder has the mean of its images' timestamps.
            if all(image is None for image in frame.images):
                continue  # its poses have a time between its neighbours'
            stamps = np.array([frame.timestamp, *frame.camera_timestamps])
        stamps = stamps[~np.isnan(stamps)]
        if len(stamps) and not stamps.min() - SAME <= poses.timestamp[row] <= stamps.max() + SAME:
            source = poses.about.source
            raise LogError(
                f"{path}: found poses of another recording ({source}), expected those of {recording}"
            )
        if not log.random_access:
            return  # reading up to the last frame would take long


def seconds_since_beginning(log: Path, poses: Poses) -> FloatArray:
    """Return the times (n,) [s] of poses since the first frame of their recording, as goals measure time.

    LogError or OSError if the poses start later than the recording, and it cannot be read.
    """
    if not len(poses) or poses.index[0] == 0:
        return poses.timestamp - poses.timestamp[:1]
    with open_log(log, recover=True) as opened:
        first = next(iter(opened), None)
    if first is None:
        raise LogError(f"{log}: found no frame that can be read, expected the first one")
    return poses.timestamp - first.newest


def goal_file(log: Path) -> Path:
    """Return the path of the goal file of a recording's job; it may not exist."""
    return (log if log.is_dir() else log.parent) / FILE_NAME


def goal_columns(log: Path, poses: Poses, model: CuboidModel) -> dict[str, Any]:
    """Return the table columns about the goal in the recording's folder; empty without a goal."""
    path = goal_file(log)
    if not path.is_file():
        return {}
    try:
        goal = read_job_goal(path)
        found: dict[str, Any] = {"task": goal.task, "level": goal.level}
        if goal.task == "rearrange_dice":
            return found
        _, over_time = scored(goal, best(poses), seconds_since_beginning(log, poses), model)
    except (TaskError, LogError, OSError) as error:
        return {"goal_fault": unicode_text(reason(error))}
    return {**found, **over_time}


def scored(
    goal: JobGoal, columns: MeasuredColumns, seconds: FloatArray, model: CuboidModel
) -> tuple[FloatArray, dict[str, float | None]]:
    """Return rewards (n,) of poses (n,) at times (n,) [s] since the beginning, and their `totals`.

    A pose is held until the next. A goal that begins between two frames counts from then on.
    """
    position, orientation = held(columns.position), held(columns.orientation)
    begins = np.array([step for step, _ in goal.trajectory]) / STEPS_PER_SECOND
    at = np.searchsorted(seconds, begins)
    times = np.union1d(seconds, begins[(at > 0) & (at < len(seconds))])
    last = np.searchsorted(seconds, times, side="right") - 1
    rewards = goal.rewards(times, position[last], orientation[last], model)
    return goal.rewards(seconds, position, orientation, model), totals(rewards, times)


def held(values: FloatArray) -> FloatArray:
    """Replace NaN rows of values (n, …) by the last row before that is not NaN, or else the first one."""
    known = np.flatnonzero(~np.isnan(values).any(axis=tuple(range(1, values.ndim))))
    if not len(known):
        return values
    return values[known[np.maximum(np.searchsorted(known, np.arange(len(values)), side="right") - 1, 0)]]


def totals(rewards: FloatArray, seconds: FloatArray) -> dict[str, float | None]:
    """Return sum and mean over control steps of rewards (n,) at times (n,) [s], and the final error.

    Each reward is held until the next; NaN is replaced by the reward before, or the first. None if all are.
    """
    rewards = held(rewards)
    if np.isnan(rewards).all():
        return dict.fromkeys(("reward_total", "reward_mean", "error_end"))
    steps = np.diff(seconds)
    steps = STEPS_PER_SECOND * np.append(steps, np.median(steps) if len(steps) else 0.1)
    total = float(np.sum(rewards * steps))
    mean = total / float(steps.sum()) if steps.sum() > 0 else float(np.mean(rewards))
    return {"reward_total": total, "reward_mean": mean, "error_end": 0.0 - float(rewards[-1])}


STEP = 0.002
"""Shortest movement that counts towards a path's length [m]: poses of an object at rest differ by less."""

FAST = 99.0  # percentile of the reported speed, rather than the maximum, which depends on a single frame

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
    "warning": str,
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
"""Columns of the table and their types; docs/batch.md describes them."""


def row(job: Job, tracked: Tracked, warning: str | None) -> dict[str, Any]:
    """Return the table row of a recording, under COLUMNS; None for unknown values.

    warning: see `remark_on_recording`.
    """
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
        found |= {
            "seconds": float(poses.timestamp[-1] - poses.timestamp[0]),
            "share_found": numbers["measured"],
            "share_filtered": numbers["filtered"],
            "warning": warning and unicode_text(warning),
        }
        found |= {f"share_{name}": float(np.mean(poses.status == name)) for name in ("coasting", "lost")}
        found |= {f"recorded_{name}": value for name, value in (numbers["recorded"] or {}).items()}
        found |= _worst(numbers["cameras"] or {}) | _sure_and_far(tracked)
        found |= goal_columns(job.log, poses, job.recipe.model)
    return {name: found.get(name) for name in COLUMNS}


def path_length(positions: FloatArray) -> float:
    """Return the length [m] of the path along positions (n, 3) [m]; movements up to STEP are ignored."""
    length, last = 0.0, positions[:1]
    for position in positions[1:]:
        step = float(np.linalg.norm(position - last))
        if step > STEP:
            length, last = length + step, position
    return length


def _worst(cameras: dict[str, dict[str, float | None]]) -> dict[str, Any]:
    """Return the camera that contradicts the others most often, and the share of measured frames."""
    shares = {name: its[CameraUse.CONTRADICTING.value] for name, its in cameras.items()}
    known = {name: share for name, share in shares.items() if share is not None}
    if not known:
        return {}
    worst = max(known, key=known.__getitem__)
    return {"worst_camera": worst if known[worst] else None, "worst_camera_contradicting": known[worst]}


def _sure_and_far(tracked: Tracked) -> dict[str, float]:
    """Return medians of confidence and standard deviations, path length, greatest height and FAST speed."""
    poses, columns = tracked.poses, best(tracked.poses)
    some = columns[columns.has_pose]
    if not len(some):
        return {}
    # Between two episodes the object is put elsewhere.
    starts = np.searchsorted(poses.index[columns.has_pose], tracked.episode_starts)
    std = np.sqrt(np.diagonal(some.covariance, axis1=1, axis2=2))
    found = {
        "confidence_median": float(np.median(some.confidence)),
        "position_std_median_mm": 1e3 * float(np.median(std[:, :3].max(axis=1))),
        "rotation_std_median_deg": float(np.degrees(np.median(std[:, 3:].max(axis=1)))),
        "path_length_m": sum(map(path_length, np.split(some.position, starts))),
        "height_max_m": float(some.position[:, 2].max()),
    }
    if isinstance(some, FilteredColumns):
        found["speed_p99_m_per_s"] = float(np.percentile(np.linalg.norm(some.velocity[:, :3], axis=1), FAST))
    return found
